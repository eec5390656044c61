"""Photos whose camera poses come from elsewhere: what all importers share."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..bop import DatasetError
from .camera import Camera
from .photos import DEFAULT_MAX_PX, open_photo
from .scene import Shot

CORNER_TO_CENTRE = 0.5
"""COLMAP's and NeRF tools' pixel (0, 0) is the corner of the first pixel; here it is its middle."""


@dataclass(frozen=True)
class Posed:
    """An image by its name, before it is opened."""

    name: str
    path: Path
    camera: Camera
    camera_from_world: np.ndarray  # [4, 4], in the source's unit


def open_all(posed: Sequence[Posed], metres_per_unit: float, max_px: int = DEFAULT_MAX_PX) -> list[Shot]:
    """Opens the photos as they lie on disk: whoever posed them saw them so, whichever way up they are held."""
    if not np.isfinite(metres_per_unit) or metres_per_unit <= 0:
        raise DatasetError(f"unit {metres_per_unit}: must be above 0")
    shots = []
    for one in posed:
        check_pose(one)
        photo = replace(open_photo(one.path, max_px), name=one.name)
        camera = one.camera
        if (camera.width, camera.height) == (photo.height, photo.width) and photo.width != photo.height:
            raise DatasetError(f"{one.path}: the camera is for {camera.width}x{camera.height} px: the photo is turned")
        pose = one.camera_from_world.copy()
        pose[:3, 3] *= metres_per_unit
        shots.append(Shot(photo, camera.scaled(photo.width, photo.height), pose))
    return shots


def check_pose(one: Posed) -> None:
    turn = one.camera_from_world[:3, :3]
    if not np.isfinite(one.camera_from_world).all() or np.abs(turn @ turn.T - np.eye(3)).max() > 0.01:
        raise DatasetError(f"{one.name}: its pose's rotation is none (three rows of length 1 at right angles)")
    if np.linalg.det(turn) < 0:
        raise DatasetError(f"{one.name}: its pose mirrors the scene")


def quaternion_pose(wxyz: Sequence[float], translation: Sequence[float], where: str) -> np.ndarray:
    """`[4, 4]`."""
    w, x, y, z = wxyz
    if not 0.9 < np.linalg.norm(wxyz) < 1.1:
        raise DatasetError(f"{where}: the quaternion's length is {np.linalg.norm(wxyz):.3f}, not 1")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat([x, y, z, w]).as_matrix(), translation
    return pose


def find_image(folders: Sequence[Path], name: str, where: str) -> Path:
    """A photo by a name that a file tells: below the folders only."""
    for folder in folders:
        path = folder / name
        # By its words: that the photos themselves are links is their owner's doing.
        if path.is_file() and Path(os.path.abspath(folder)) in Path(os.path.abspath(path)).parents:
            return path
    known = ", ".join(dict.fromkeys(str(folder) for folder in folders))
    raise DatasetError(f"{where}: no photo {name!r} in {known}")
