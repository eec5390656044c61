"""How photos became a project's images: what was drawn into a photo elsewhere can be carried over."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ..bop import read_json
from .camera import Camera, parse_camera
from .photos import TURNS, Photo

FILE = "originals.json"
SWAPPED = (5, 6, 7, 8)
"""EXIF orientations that swap width and height."""
MIRRORED = (2, 4, 5, 7)


@dataclass(frozen=True)
class Original:
    """One photo as it lies on disk."""

    width: int
    height: int
    orientation: int  # EXIF's: how it becomes upright
    camera: Camera  # of the photo as it was read: smaller, if it was large, and turned only if it was mirrored

    @property
    def upright_size(self) -> tuple[int, int]:
        return (self.height, self.width) if self.orientation in SWAPPED else (self.width, self.height)

    @property
    def turns(self) -> int:
        """Quarter turns to the right from the photo as it was read to the project's image."""
        return 0 if self.orientation in MIRRORED else TURNS.get(self.orientation, 0)

    def points(self, pixels: np.ndarray, upright: bool) -> np.ndarray:
        """Pixels `[N, 2]` of the photo, of its stored or its upright state, in the project's image."""
        width, height = self.upright_size if upright else (self.width, self.height)
        if self.orientation in MIRRORED:
            if not upright:
                pixels = reoriented(pixels, (width, height), self.orientation)
                width, height = self.upright_size
        elif upright:
            for _ in range(-self.turns % 4):
                pixels, width, height = np.column_stack([height - 1 - pixels[:, 1], pixels[:, 0]]), height, width
        scale = np.array([self.camera.width / width, self.camera.height / height])
        pixels = self.camera.undistort_points((pixels + 0.5) * scale - 0.5)
        height, width = self.camera.height, self.camera.width
        for _ in range(self.turns):
            pixels, width, height = np.column_stack([height - 1 - pixels[:, 1], pixels[:, 0]]), height, width
        return pixels

    def mask(self, mask: np.ndarray, upright: bool) -> np.ndarray:
        """A mask of 0 and 255 of the photo as one of the project's image."""
        if self.orientation in MIRRORED:
            mask = mask if upright else REORIENT[self.orientation](mask)
        elif upright:
            mask = np.rot90(mask, self.turns)
        size = self.camera.width, self.camera.height
        if mask.shape[1::-1] != size:
            mask = cv2.resize(np.ascontiguousarray(mask), size, interpolation=cv2.INTER_AREA)
        mask = np.rot90(self.camera.undistort(np.ascontiguousarray(mask)), -self.turns)
        return (mask > 127) * np.uint8(255)


REORIENT = {
    2: lambda image: image[:, ::-1],
    4: lambda image: image[::-1],
    5: lambda image: image.T,
    7: lambda image: image[::-1, ::-1].T,
}


def reoriented(pixels: np.ndarray, size: tuple[int, int], orientation: int) -> np.ndarray:
    """Pixels of a mirrored photo in its upright state; `size` is the stored one."""
    x, y = pixels.T
    across, down = size[0] - 1 - x, size[1] - 1 - y
    return np.column_stack({2: (across, y), 4: (x, down), 5: (y, x), 7: (down, across)}[orientation])


def write_originals(scene: Path, photos: Sequence[tuple[Photo, Camera]]) -> None:
    cameras: list[dict] = []
    images = {}
    for number, (photo, camera) in enumerate(photos):
        stated = camera.as_dict()
        if stated not in cameras:
            cameras.append(stated)
        width, height = photo.stored
        images[str(number)] = {"width": width, "height": height, "orientation": photo.orientation}
        images[str(number)]["camera"] = cameras.index(stated)
    (scene / FILE).write_text(json.dumps({"cameras": cameras, "images": images}))


def read_originals(scene: Path) -> dict[int, Original]:
    """By image; empty for a scene of an older version."""
    path = scene / FILE
    values = read_json(path) if path.exists() else {"cameras": [], "images": {}}
    cameras = [parse_camera(stated, str(path)) for stated in values["cameras"]]
    return {
        int(key): Original(one["width"], one["height"], one["orientation"], cameras[one["camera"]])
        for key, one in values["images"].items()
    }
