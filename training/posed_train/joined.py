"""Where a net placed components that geometry alone cannot place, and an exported net its keypoints: kept beside a
training, so that one that goes on has the same views, held out and not."""

import json
from pathlib import Path

import numpy as np

from . import bop
from .config import KeypointConfig
from .data import Views

NAME_PARTS = 4
"""Split, scene, rgb and file: a project may be moved."""


def write(path: Path, views: Views) -> None:
    placed = {
        name_of(views, component.views[0]): component.component_from_keypoints.ravel().tolist()
        for component in views.registration.components[1:]
        if component.component_from_keypoints is not None
    }
    write_json(path, {"placed": placed, "held_out": [name_of(views, index) for index in views.held_out]})


def read(path: Path, views: Views) -> None:
    stored = bop.read_json(path) if path.exists() else {}
    # Before views that were placed late were held out, the file had the places alone.
    placed = {short(Path(name)): pose for name, pose in stored.get("placed", stored).items()}
    for component in views.registration.components:
        pose = placed.get(name_of(views, component.views[0]))
        if pose is not None and component.component_from_keypoints is None:
            views.registration.place(component, np.array(pose).reshape(4, 4))
    if "held_out" in stored:
        known = set(stored["held_out"])
        chosen = [k for k in views.registration.placed if k < views.photoreal_count and name_of(views, k) in known]
        views.held_out = sorted(chosen)


def name_of(views: Views, index: int) -> str:
    return short(views.all[index].image_path)


def short(path: Path) -> str:
    return "/".join(path.parts[-NAME_PARTS:])


def write_adopted(path: Path, views: Views) -> None:
    """Where the keypoints of an exported net are."""
    placement = views.registration.components[0].component_from_keypoints
    write_json(path, {"keypoints_m": views.registration.keypoints.tolist(), "placement": placement.tolist()})


def read_adopted(path: Path, config: KeypointConfig, views: Views) -> None:
    stored = bop.read_json(path)
    views.place_keypoints(config, np.array(stored["keypoints_m"]), np.array(stored["placement"]))


def write_json(path: Path, value: dict) -> None:
    part = path.with_suffix(".part")
    part.write_text(json.dumps(value))
    part.replace(path)
