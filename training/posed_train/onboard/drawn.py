"""The file of `label --box`: by object, boxes drawn in a few photos, or the 3D box itself.

    {"bottle": {"solid": "cylinder", "boxes": {"IMG_1.jpg": [x, y, w, h], "IMG_7.jpg": [...], "IMG_30.jpg": [...]}},
     "cube": {"base_mm": [12, -40], "yaw_deg": 30, "size_mm": [54, 54, 54], "symmetries": ["x4", "z4"]},
     "bad photos": ["IMG_12.jpg"]}

In bad photos nothing is labelled. Pixels are those of the project's images (upright, undistorted), `base_mm` is in the
frame in which things stand; with a third number where they do not stand on a board. `size_mm` is length, width and
height. With several scenes, a 3D box names its own (`"scene": "000001"`). `"up": "y"` names the axis of the object's
frame that points up.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from .project import SOLIDS, UPS, Project
from .solid import Frame, Solid
from .symmetry import motions

LEAST_BOXES = 2
BAD = "bad photos"
"""No object can have that name."""


@dataclass(frozen=True)
class Drawn:
    """What a person said of one object."""

    kind: str | None  # one of SOLIDS, if told
    boxes: dict[str, np.ndarray] = field(default_factory=dict)
    """Left, top, right, bottom by the photo's name, pixels."""
    solid: Solid | None = None
    scene: str | None = None
    """Of the solid, if told."""
    up: str | None = None  # one of UPS, if told
    symmetries: list[str] | None = None

    def is_of(self, scene: str, photos: set[str], alone: bool) -> bool:
        """Whether it is of a scene with these photos; `alone` if there is no other."""
        if self.solid is not None:
            return scene == self.scene or (alone and self.scene is None)
        return set(self.boxes) <= photos

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
    bad = values.get(BAD, [])
    if not isinstance(bad, list) or not all(isinstance(photo, str) for photo in bad):
        raise DatasetError(f"{path}: {BAD!r} is a list of photos' names")
    for photo in bad:
        if photo not in known_photos:
            raise DatasetError(f"{path}: {BAD}: no photo {photo!r} in the project (or it has no camera pose)")
    objects = {name: entry for name, entry in values.items() if name != BAD}
    for name in objects:
        project.item(name)
    return {name: read_one(entry, f"{path}: {name}", known_photos) for name, entry in objects.items()}


def read_one(entry: object, where: str, known_photos: set[str]) -> Drawn:
    if not isinstance(entry, dict):
        raise DatasetError(f'{where}: needs "boxes" by photo, or base_mm, yaw_deg and size_mm')
    kind = entry.get("solid")
    if kind is not None and kind not in SOLIDS:
        raise DatasetError(f"{where}: solid {kind!r}: choose one of {', '.join(SOLIDS)}")
    up, symmetries = entry.get("up"), entry.get("symmetries")
    if up is not None and up not in UPS:
        raise DatasetError(f"{where}: up {up!r}: choose one of {', '.join(UPS)}")
    if symmetries is not None:
        if not isinstance(symmetries, list):
            raise DatasetError(f'{where}: symmetries is a list, as ["z2"]')
        motions([str(one) for one in symmetries])
    if "size_mm" in entry:
        solid = read_solid(entry, kind or "box", where)
        return Drawn(kind or "box", solid=solid, scene=entry.get("scene"), up=up, symmetries=symmetries)
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
    return Drawn(kind, edges, up=up, symmetries=symmetries)


def read_solid(entry: dict, kind: str, where: str) -> Solid:
    size = np.array(numbers(entry["size_mm"], 3, f"{where}: size_mm")) / 1000
    told = entry.get("base_mm")
    base = numbers(told, 3 if isinstance(told, list) and len(told) == 3 else 2, f"{where}: base_mm")
    (yaw,) = numbers([entry.get("yaw_deg", 0)], 1, f"{where}: yaw_deg")
    if size.min() <= 0:
        raise DatasetError(f"{where}: size_mm must be above 0")
    return Solid(kind, np.array([*base, 0.0][:3]) / 1000, np.radians(yaw), size)


def numbers(value: object, count: int, where: str) -> list[float]:
    good = isinstance(value, list) and len(value) == count
    if not good or not all(isinstance(one, int | float) and np.isfinite(one) for one in value):
        raise DatasetError(f"{where}: needs {count} numbers")
    return [float(one) for one in value]
