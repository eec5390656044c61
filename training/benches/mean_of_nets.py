"""Exports the mean of the best nets of several trainings of one object that went on from one another (Wortsman et al.,
"Model soups", ICML 2022): as the demo cube was made.

    .venv/bin/python -m benches.mean_of_nets demo/cameras/cube-2.toml RUN RUN --data DATA --models MODELS
"""

import argparse
from pathlib import Path

import torch

from posed_train import config, export, joined, train
from posed_train.data import Views
from posed_train.network import KeypointNet


def mean(states: list[dict[str, torch.Tensor]]) -> dict[str, torch.Tensor]:
    last = states[-1]
    return {
        name: torch.stack([state[name] for state in states]).mean(0) if value.is_floating_point() else value
        for name, value in last.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("settings", type=Path, help="train.toml of the last one")
    parser.add_argument("runs", type=Path, nargs="+", help="their folders with best.pt, the last one's last")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--models", type=Path, required=True)
    arguments = parser.parse_args()
    settings = config.load(arguments.settings, config.KeypointConfig)
    views = Views(settings, arguments.data)
    adopted = arguments.runs[-1] / "adopted.json"
    if adopted.exists():
        joined.read_adopted(adopted, settings, views)
    net = KeypointNet(len(views.registration.keypoints), settings.network)
    best = [torch.load(run / "best.pt", map_location="cpu", weights_only=True) for run in arguments.runs]
    net.load_state_dict(mean([one["average"] for one in best]))
    scores = train.Validator(settings, arguments.data, views)(net)
    summary = {
        "network": settings.network,
        "mean_of_steps": [one["step"] for one in best],
        "views": len(views.all),
        "relative_poses": settings.poses,
        "validation": {key: round(value, 2) for key, value in scores.items()},
    }
    identity = {"name": settings.name, "obj_id": settings.obj_id}
    out = arguments.models / settings.name
    export.export_keypoints(net, views, out, identity, summary, settings.symmetries_discrete)
    print(f"{out}: {summary}")


if __name__ == "__main__":
    main()
