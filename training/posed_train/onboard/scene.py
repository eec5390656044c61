"""Writes posed photos as a scene of a BOP dataset: upright, without distortion."""

import json
import shutil
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..bop import pose_entry, write_annotations, write_image
from .camera import Camera
from .originals import write_originals
from .photos import Photo
from .project import PHOTOS


@dataclass(frozen=True)
class Shot:
    """A photo, its camera and where the camera was."""

    photo: Photo
    camera: Camera
    camera_from_world: np.ndarray  # [4, 4] metres

    @property
    def upright(self) -> tuple[np.ndarray, np.ndarray]:
        """Camera matrix and `camera_from_world` once the photo is turned upright."""
        matrix, pose = self.camera.matrix, self.camera_from_world
        height, width = self.camera.height, self.camera.width
        for _ in range(self.photo.turns):
            fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
            matrix = np.array([[fy, 0, height - 1 - cy], [0, fx, cx], [0, 0, 1]])
            pose = QUARTER_TURN @ pose
            height, width = width, height
        return matrix, pose


QUARTER_TURN = np.array([[0, -1.0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
"""Of the camera's frame when its image is turned to the right."""


def write_scene(shots: Sequence[Shot], out: Path) -> None:
    """Images, cameras and no objects yet."""
    (out / "rgb").mkdir(parents=True)
    with ThreadPoolExecutor() as pool:
        list(pool.map(lambda numbered: write_photo(numbered[1], out / "rgb", numbered[0]), enumerate(shots)))
    cameras = {}
    for number, shot in enumerate(shots):
        matrix, pose = shot.upright
        cameras[str(number)] = {"cam_K": matrix.ravel().tolist()} | pose_entry(pose, "w2c")
    write_originals(out, [(shot.photo, shot.camera) for shot in shots])
    (out / PHOTOS).write_text(json.dumps({str(k): shot.photo.name for k, shot in enumerate(shots)}, indent=1))
    empty = {str(number): [] for number in range(len(shots))}
    write_annotations(out, cameras, empty, empty)


def write_photo(shot: Shot, folder: Path, number: int) -> None:
    photo = shot.photo
    original = photo.path.suffix.lower()
    as_it_is = not (shot.camera.distorted or photo.turns or photo.mirrored)
    if as_it_is and original in (".jpg", ".png") and photo.unscaled:
        shutil.copyfile(photo.path, folder / f"{number:06d}{original}")
        return
    image = np.ascontiguousarray(np.rot90(shot.camera.undistort(photo.read()), -photo.turns))
    write_image(folder / f"{number:06d}.jpg", image)


def photo_names(scene: Path) -> dict[int, str]:
    """By image; the image's own file where the scene does not tell."""
    try:
        return {int(key): str(name) for key, name in json.loads((scene / PHOTOS).read_text()).items()}
    except (OSError, ValueError, AttributeError):
        return {int(p.stem): p.name for p in sorted((scene / "rgb").iterdir()) if p.stem.isdigit()}
