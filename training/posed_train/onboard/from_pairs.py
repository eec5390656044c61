"""Stereo pairs with known relative pose, each a component of its own: the paper's setting.

{"left_camera": "left.json", "right_camera": "right.json",
 "right_from_left": {"rotation_xyzw": [0, 0, 0, 1], "translation_m": [-0.1, 0, 0]},
 "pairs": [{"left": "l0.png", "right": "r0.png"}, {"left": ..., "right": ..., "right_from_left": {...}}, ...]}
"""

import json
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from .camera import read_camera
from .posed_photos import Posed, find_image, quaternion_pose


def read_pairs(path: Path, photos: Path | None) -> list[list[Posed]]:
    try:
        values = json.loads(path.read_text())
        pairs = values["pairs"]
        cameras = [read_camera(path.parent / values[f"{side}_camera"]) for side in ("left", "right")]
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, DatasetError):
            raise
        raise DatasetError(f"{path}: not a file of pairs; it needs left_camera, right_camera and pairs") from None
    if not isinstance(pairs, list):
        raise DatasetError(f"{path}: pairs is not a list")
    folders = [folder for folder in (photos, path.parent) if folder is not None]
    scenes, seen = [], {}
    for number, pair in enumerate(pairs):
        where = f"{path}: pair {number}"
        if not isinstance(pair, dict) or not all(isinstance(pair.get(side), str) for side in ("left", "right")):
            raise DatasetError(f"{where}: needs left and right, names of photos")
        if pair["left"] == pair["right"]:
            raise DatasetError(f"{where}: {pair['left']} twice; a pair is two photos")
        if (twin := seen.setdefault((pair["left"], pair["right"]), number)) != number:
            raise DatasetError(f"{where}: the same photos as pair {twin}")
        relative = pair.get("right_from_left", values.get("right_from_left"))
        scenes.append(
            [
                Posed(Path(name).name, find_image(folders, name, where), camera, pose)
                for name, camera, pose in (
                    (pair["left"], cameras[0], np.eye(4)),
                    (pair["right"], cameras[1], read_relative(relative, where)),
                )
            ]
        )
    if not scenes:
        raise DatasetError(f"{path}: no pairs")
    return scenes


def read_relative(value: object, where: str) -> np.ndarray:
    try:
        x, y, z, w = (float(v) for v in value["rotation_xyzw"])
        translation = [float(v) for v in value["translation_m"]]
        if len(translation) != 3:
            raise ValueError("3 numbers")
    except (KeyError, TypeError, ValueError):
        raise DatasetError(f"{where}: needs right_from_left with rotation_xyzw and translation_m") from None
    return quaternion_pose([w, x, y, z], translation, where)
