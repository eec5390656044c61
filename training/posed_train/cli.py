"""Trains the networks that posed serves, from images with known relative camera poses."""

import argparse
import importlib.util
import subprocess
import sys
from pathlib import Path

import cv2
import torch

from . import ablate, check, config, cut_off, data, detector, export, pack, quantize, train
from .bop import DatasetError
from .onboard import command as onboarding
from .render import command as rendering

BLENDER_PYTHON = Path(__file__).parents[1] / ".venv-blender/bin/python"


def main() -> None:
    parser = argparse.ArgumentParser(prog="posed-train", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    onboarding.add_commands(commands)

    render = commands.add_parser("render", help="render random scenes of coloured meshes into a BOP-format folder")
    rendering.add_arguments(render)
    render.set_defaults(run=run_render)

    checking = commands.add_parser("check", help="tell whether a dataset can teach a keypoint net, before training")
    checking.add_argument("settings", type=Path, help="train.toml")
    checking.add_argument("--data", type=Path, required=True, help="folder that the paths in train.toml start from")
    checking.set_defaults(run=run_check)

    packing = commands.add_parser("pack", help="copy what a keypoint net's training needs of a dataset, as small crops")
    packing.add_argument("settings", type=Path, help="train.toml")
    packing.add_argument("out", type=Path, help="new folder, to be given as --data")
    packing.add_argument("--data", type=Path, required=True, help="folder that the paths in train.toml start from")
    packing.set_defaults(run=run_pack)

    cutting = commands.add_parser("cut-off", help="make half-hidden views for `posed evaluate` of a split's whole ones")
    cutting.add_argument("split", type=Path, help="folder of scenes, with masks")
    cutting.add_argument("out", type=Path, help="new folder")
    cutting.add_argument("--objects", type=int, nargs="+", required=True, help="by their obj_id")
    cutting.set_defaults(run=run_cut_off)

    keypoints = commands.add_parser("keypoints", help="train one object's keypoint net and export it")
    detect = commands.add_parser("detector", help="train the detector of all objects and export it")
    for command in (keypoints, detect):
        command.add_argument("settings", type=Path, help="train.toml")
        command.add_argument("--data", type=Path, required=True, help="folder that the paths in train.toml start from")
        command.add_argument("--runs", type=Path, default=Path("runs"), help="checkpoints and logs; resumed from")
        command.add_argument("--models", type=Path, default=Path("models"), help="where the export goes")
        command.add_argument("--init", type=Path, help="checkpoint of a keypoint net to start from")
        command.add_argument("--threads", type=int, default=torch.get_num_threads())
    ablating = commands.add_parser("ablate", help="train one object's net in several ways and print a table")
    ablating.add_argument("settings", type=Path, help="train.toml")
    ablating.add_argument("--data", type=Path, required=True, help="folder that the paths in train.toml start from")
    ablating.add_argument("--runs", type=Path, default=Path("runs"))
    ablating.add_argument(
        "--only", type=int, nargs="*", default=range(len(ablate.VARIANTS)), help="some of the variants"
    )
    ablating.add_argument("--threads", type=int, default=torch.get_num_threads())
    ablating.set_defaults(run=run_ablate)
    keypoints.add_argument("--workers", type=int, default=0, help="processes that prepare batches; a GPU needs several")
    keypoints.set_defaults(run=run_keypoints)
    detect.set_defaults(run=run_detector)

    quantizing = commands.add_parser("quantize", help="copy an exported keypoint net to compute in 8 bits, and compare")
    quantizing.add_argument("settings", type=Path, help="train.toml of its training")
    quantizing.add_argument("model", type=Path, help="model folder")
    quantizing.add_argument("out", type=Path, help="new model folder")
    quantizing.add_argument("--data", type=Path, required=True, help="folder that the paths in train.toml start from")
    quantizing.set_defaults(run=run_quantize)

    arguments = parser.parse_args()
    try:
        arguments.run(arguments)
    except (DatasetError, ValueError, FloatingPointError, OSError) as error:
        sys.exit(f"posed-train: {error}")


def run_render(arguments: argparse.Namespace) -> None:
    if arguments.engine == "cycles" and importlib.util.find_spec("bpy") is None:
        # Blender has an environment of its own: it wants an older numpy than PyTorch's friends do.
        if not BLENDER_PYTHON.exists():
            raise OSError(f"{BLENDER_PYTHON} is missing: `make render-env` installs Blender there")
        sys.exit(subprocess.run([BLENDER_PYTHON, "-m", "posed_train.render.command", *sys.argv[2:]]).returncode)
    rendering.run(arguments)


def run_check(arguments: argparse.Namespace) -> None:
    settings = config.load(arguments.settings, config.KeypointConfig)
    print(check.check(data.read_photoreal(settings, arguments.data), settings.poses))


def run_pack(arguments: argparse.Namespace) -> None:
    settings = config.load(arguments.settings, config.KeypointConfig)
    written = pack.pack(settings, arguments.data, arguments.out)
    print(f"{arguments.out}: {written / 1e6:.1f} MB")


def run_cut_off(arguments: argparse.Namespace) -> None:
    print(f"{arguments.out}: {cut_off.cut_off(arguments.split, arguments.out, arguments.objects)} views")


def run_ablate(arguments: argparse.Namespace) -> None:
    use_threads(arguments.threads)
    settings = config.load(arguments.settings, config.KeypointConfig)
    ablate.run(settings, arguments.data, arguments.runs, list(arguments.only))
    print(ablate.table(settings, arguments.runs))


def use_threads(count: int) -> None:
    torch.set_num_threads(count)
    cv2.setNumThreads(count)


def run_keypoints(arguments: argparse.Namespace) -> None:
    use_threads(arguments.threads)
    settings = config.load(arguments.settings, config.KeypointConfig)
    print(check.check(data.read_photoreal(settings, arguments.data), settings.poses))
    net, views, scores, step = train.train(
        settings, arguments.data, arguments.runs / settings.name, arguments.init, arguments.workers
    )
    summary = {
        "network": settings.network,
        "steps": settings.steps,
        "best_step": step,
        "views": len(views.all),
        "relative_poses": settings.poses,
        "validation": {key: round(value, 2) for key, value in scores.items()},
    }
    identity = {"name": settings.name, "obj_id": settings.obj_id}
    out = arguments.models / settings.name
    export.export_keypoints(net.cpu(), views, out, identity, summary, settings.symmetries_discrete)
    print(f"{out}: {summary}")


def run_quantize(arguments: argparse.Namespace) -> None:
    settings = config.load(arguments.settings, config.KeypointConfig)
    print(quantize.table(quantize.quantize(settings, arguments.data, arguments.model, arguments.out)))


def run_detector(arguments: argparse.Namespace) -> None:
    use_threads(arguments.threads)
    settings = config.load(arguments.settings, config.DetectorConfig)
    model = detector.train(settings, arguments.data, arguments.runs / "detector", arguments.init)
    scores = {}
    if settings.validation:
        scores = detector.recall(model, detector.read_samples(arguments.data / settings.validation, settings.obj_ids))
    summary = {"steps": settings.steps, "validation": {key: round(value, 3) for key, value in scores.items()}}
    out = arguments.models / "detector"
    export.export_detector(model.cpu(), settings.labels, out, summary, settings.score_threshold)
    print(f"{out}: {summary}")
