"""Scores a keypoint net on held-out photos of an object, as they are and under conditions that training did not have:
before other backgrounds, in light of other temperatures, under other lamps, from nearer. And in another room.

    .venv/bin/python -m benches.other_conditions SETTINGS CHECKPOINT --data DATA --held-out SPLIT --backgrounds PHOTOS
        [--room SPLIT --learned SPLIT]

SETTINGS and DATA are those of the training, whose relative poses are those of cameras in one frame; SPLIT has photos in
that frame. ROOM and LEARNED state object poses: one photo of the room gives the offset, the one with the highest peaks,
and the others are scored by how far their direction is from the nearest photographed one.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import torch

from posed_train import bop, config, corrupt
from posed_train.data import Views, read_backgrounds
from posed_train.metrics import rotation_error_deg, translation_error_m
from posed_train.network import KeypointNet
from posed_train.novel_views.studio import Studio
from posed_train.train import predictor
from posed_train.validate import Predictor, predict_views, solve_pose

RENDERED_PX = 480
ROOM = 2.6
BINS_DEG = 5, 10, 20, 180


def read_net(path: Path, keypoints: np.ndarray, network: str) -> KeypointNet:
    state = torch.load(path, map_location="cpu", weights_only=True)["average"]
    net = KeypointNet(len(keypoints), network)
    net.load_state_dict({name: value.float() if value.is_floating_point() else value for name, value in state.items()})
    return net


def conditions(views: list[bop.View], backgrounds: list[np.ndarray], out: Path) -> Iterator[tuple[str, list[bop.View]]]:
    """Copies of the photos, the same every time."""
    rng = np.random.default_rng(99)
    studio = Studio(views, np.stack([view.camera_from_world for view in views]))
    sets: dict[str, list[bop.View]] = {"as taken": list(views)}

    def put(name: str, view: bop.View, image: np.ndarray) -> None:
        path = out / name.replace(" ", "-") / f"{view.image_id:06d}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        bop.write_rgb(path, image)
        sets.setdefault(name, []).append(replace(view, image_path=path))

    for view in views:
        image = bop.read_rgb(view.image_path)
        weight = cv2.GaussianBlur(bop.read_mask(view), (0, 0), 0.7)[..., None] / 255
        behind = cv2.resize(backgrounds[rng.integers(len(backgrounds))], image.shape[1::-1])
        pasted = (image * weight + behind * (1 - weight)).astype(np.uint8)
        put("other backgrounds", view, pasted)
        put("and 4300 K", view, corrupt.white_balance(pasted, 4300))
        put("and 10,000 K", view, corrupt.white_balance(pasted, 10000))
        put("and gamma 0.6", view, corrupt.gamma(pasted, 0.6))
        for name, share in (("under other lamps", 1.0), ("and 0.7 of the distance", 0.7)):
            pose = view.camera_from_world.copy()
            pose[:3, 3] += (share - 1) * (pose[:3, :3] @ studio.shape.middle + pose[:3, 3])
            made = studio.render(pose, view.camera_matrix, RENDERED_PX, ROOM, rng)
            if made is None:
                continue
            behind = cv2.resize(backgrounds[rng.integers(len(backgrounds))], (RENDERED_PX, RENDERED_PX))
            weight = made.mask[..., None] / 255
            image = (made.rgb * weight + behind * (1 - weight)).astype(np.uint8)
            image = corrupt.gamma(
                corrupt.white_balance(image, float(rng.uniform(4000, 9000))), np.exp(rng.normal(0, 0.2))
            )
            put(name, replace(view, camera_matrix=made.camera_matrix, camera_from_world=pose, box=made.box), image)
    yield from sets.items()


def figures(found: Sequence[np.ndarray | None], true: Sequence[np.ndarray]) -> str:
    pairs = [(pose, expected) for pose, expected in zip(found, true) if pose is not None]
    degrees = [rotation_error_deg(*pair) for pair in pairs] + [180.0] * (len(found) - len(pairs))
    metres = [translation_error_m(*pair) for pair in pairs] + [9.0] * (len(found) - len(pairs))
    depth = [100 * (pose[2, 3] / expected[2, 3] - 1) for pose, expected in pairs]
    good = np.mean([turn < 5 and shift < 0.05 for turn, shift in zip(degrees, metres)])
    return (
        f"| {len(found)} | {100 * good:.1f} | {np.median(degrees):.1f} | {1000 * np.median(metres):.1f} | "
        f"{np.median(depth) if depth else np.nan:+.1f} |"
    )


def directions(views: Sequence[bop.View]) -> np.ndarray:
    """From the object to the cameras, `[V, 3]`."""
    towards = np.stack([-view.camera_from_object[:3, :3].T @ view.camera_from_object[:3, 3] for view in views])
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def score_room(net: Predictor, keypoints: np.ndarray, room: Path, learned: Path, obj_id: int) -> None:
    views = bop.read_views(room, obj_id, 0.5)
    predictions = predict_views(net, views)
    poses = [solve_pose(keypoints, prediction) for prediction in predictions]
    peaks = [-1.0 if pose is None else np.median(p.peaks) for pose, p in zip(poses, predictions)]
    reference = int(np.argmax(peaks))
    offset = np.linalg.inv(poses[reference]) @ views[reference].camera_from_object
    known = directions(bop.read_views(learned, obj_id, 0.5))
    apart = np.degrees(np.arccos(np.clip(directions(views) @ known.T, -1, 1))).min(1)
    print(f"reference: {views[reference].image_path.name}, {apart[reference]:.1f} degrees from a photo")
    low = 0
    for high in (*BINS_DEG, None):
        chosen = [
            k
            for k in range(len(views))
            if k != reference and (apart[k] <= BINS_DEG[1] if high is None else low < apart[k] <= high)
        ]
        found = [None if poses[k] is None else poses[k] @ offset for k in chosen]
        name = f"{low} to {high} degrees" if high is not None else f"all within {BINS_DEG[1]} degrees"
        if chosen:
            print(f"| {name} {figures(found, [views[k].camera_from_object for k in chosen])}", flush=True)
        low = high or 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("settings", type=Path)
    parser.add_argument("checkpoint", type=Path, help="checkpoint.pt or best.pt")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--held-out", type=Path)
    parser.add_argument("--backgrounds", type=Path)
    parser.add_argument("--room", type=Path)
    parser.add_argument("--learned", type=Path)
    arguments = parser.parse_args()
    settings = config.load(arguments.settings, config.KeypointConfig)
    views = Views(settings, arguments.data)
    keypoints = views.registration.keypoints
    net = predictor(read_net(arguments.checkpoint, keypoints, settings.network), views.heights)
    print("| photos | number | 5°5cm, % | rotation, median ° | translation, median mm | depth, median % |")
    print("|" + "---|" * 6)
    if arguments.held_out is not None:
        component = views.registration.components[0]
        known = views.all[component.views[0]].camera_from_world
        world_from_keypoints = np.linalg.inv(known) @ views.registration.placed[component.views[0]]
        held_out = bop.read_views(arguments.held_out, settings.obj_id)
        with TemporaryDirectory() as folder:
            for name, copies in conditions(
                held_out, read_backgrounds(arguments.backgrounds, RENDERED_PX), Path(folder)
            ):
                found = [solve_pose(keypoints, one) for one in predict_views(net, copies)]
                true = [view.camera_from_world @ world_from_keypoints for view in copies]
                print(f"| {name} {figures(found, true)}", flush=True)
    if arguments.room is not None:
        score_room(net, keypoints, arguments.room, arguments.learned, settings.obj_id)


if __name__ == "__main__":
    main()
