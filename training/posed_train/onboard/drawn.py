"""The file of `label --box`: by object, boxes drawn in a few photos, or the 3D box itself.

    {"bottle": {"solid": "cylinder", "boxes": {"IMG_1.jpg": [x, y, w, h], "IMG_7.jpg": [...], "IMG_30.jpg": [...]}},
     "cube": {"base_mm": [12, -40], "yaw_deg": 30, "size_mm": [54, 54, 54]}}

Pixels of the project's images (upright, undistorted); `base_mm` in the frame in which things stand.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from .project import SOLIDS, Project
from .solid import Frame, Solid

LEAST_BOXES = 2


@dataclass(frozen=True)
class Drawn:
    """What a person said of one object."""

    kind: str | None  # one of SOLIDS, if told
    boxes: dict[str, np.ndarray] = field(default_factory=dict)
    """Left, top, right, bottom by the photo's name, pixels."""
    solid: Solid | None = None

    def in_frames(self, frames: list[Frame]) -> list[tuple[Frame, np.ndarray]]:
        return [(frame, self.boxes[frame.name]) for frame in frames if frame.name in self.boxes]


def read_file(path: Path) -> dict:
    try:
        values = json.loads(path.read_text())
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise DatasetError(f"{path}: not valid JSON ({error})") from None
    if not isinstance(values, dict) or not values:
        raise DatasetError(f'{path}: needs {{"OBJECT": {{"boxes": {{"PHOTO": [x, y, w, h], ...}}}}}}')
    return values


def parse(values: dict, path: Path, project: Project, known_photos: set[str]) -> dict[str, Drawn]:
    """By the object's name."""
    for name in values:
        project.item(name)
    return {name: read_one(entry, f"{path}: {name}", known_photos) for name, entry in values.items()}


def read_one(entry: object, where: str, known_photos: set[str]) -> Drawn:
    if not isinstance(entry, dict):
        raise DatasetError(f'{where}: needs "boxes" by photo, or base_mm, yaw_deg and size_mm')
    kind = entry.get("solid")
    if kind is not None and kind not in SOLIDS:
        raise DatasetError(f"{where}: solid {kind!r}: choose one of {', '.join(SOLIDS)}")
    if "size_mm" in entry:
        return Drawn(kind or "box", solid=read_solid(entry, kind or "box", where))
    boxes = entry.get("boxes")
    if not isinstance(boxes, dict) or len(boxes) < LEAST_BOXES:
        raise DatasetError(f"{where}: draw boxes in {LEAST_BOXES} photos or more; three from different sides are good")
    edges = {}
    for photo, box in boxes.items():
        if photo not in known_photos:
            raise DatasetError(f"{where}: no photo {photo!r} in the project (or it has no camera pose)")
        x, y, w, h = numbers(box, 4, f"{where}: {photo}: [x, y, w, h]")
        if min(w, h) < 2:
            raise DatasetError(f"{where}: {photo}: width and height must be 2 px or more")
        edges[photo] = np.array([x, y, x + w - 1, y + h - 1])
    return Drawn(kind, edges)


def read_solid(entry: dict, kind: str, where: str) -> Solid:
    size = np.array(numbers(entry["size_mm"], 3, f"{where}: size_mm")) / 1000
    base = numbers(entry.get("base_mm"), 2, f"{where}: base_mm")
    (yaw,) = numbers([entry.get("yaw_deg", 0)], 1, f"{where}: yaw_deg")
    if size.min() <= 0:
        raise DatasetError(f"{where}: size_mm must be above 0")
    return Solid(kind, np.array([base[0] / 1000, base[1] / 1000, 0.0]), np.radians(yaw), size)


def numbers(value: object, count: int, where: str) -> list[float]:
    good = isinstance(value, list) and len(value) == count
    if not good or not all(isinstance(one, int | float) and np.isfinite(one) for one in value):
        raise DatasetError(f"{where}: needs {count} numbers")
    return [float(one) for one in value]
