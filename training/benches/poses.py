"""Compares camera poses in two worlds: their frames, and if so wished their scales, may differ."""

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from posed_train.bop import stated_pose


def scene_poses(scene: Path) -> dict[str, np.ndarray]:
    """`camera_from_world` by the photo's name, metres."""
    cameras = json.loads((scene / "scene_camera.json").read_text())
    names = json.loads((scene / "photos.json").read_text())
    return {names[key]: stated_pose(entry, "w2c") for key, entry in cameras.items()}


def differences(found: list[np.ndarray], true: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, float]:
    """Degrees and millimetres of each pose once the worlds lie over each other, and the true scale by the found one."""
    found, true = np.stack(found), np.stack(true)
    turn = Rotation.from_matrix(np.swapaxes(true[:, :3, :3], 1, 2) @ found[:, :3, :3]).mean()
    rotations = Rotation.from_matrix(found[:, :3, :3] @ turn.as_matrix().T @ np.swapaxes(true[:, :3, :3], 1, 2))
    centres = [-np.einsum("vji,vj->vi", poses[:, :3, :3], poses[:, :3, 3]) for poses in (found, true)]
    a, b = turn.apply(centres[0] - centres[0].mean(0)), centres[1] - centres[1].mean(0)
    scale = float((a * b).sum() / (a * a).sum())
    return np.degrees(rotations.magnitude()), 1000 * np.linalg.norm(scale * a - b, axis=1), scale
