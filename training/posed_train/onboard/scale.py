"""The scale of camera poses whose unit is not known: by a board's tags in the photos, or by two clicked points.

{"a": {"IMG_1.jpg": [x, y], "IMG_7.jpg": [x, y]}, "b": {...}, "mm": 120}
"""

import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from ..rays import nearest_point
from .scene import Shot
from .tags import MIN_TAGS, find_all

LEAST_ANGLE_DEG = 3.0
LEAST_TAGS_SEEN = 3


def triangulate(seen: Sequence[tuple[Shot, np.ndarray]]) -> np.ndarray | None:
    """The point nearest to the rays through pixels `[2]` of photos; None if the rays are nearly parallel."""
    directions, origins = [], []
    for shot, pixel in seen:
        x, y = shot.camera.undistort_points(np.asarray(pixel, float)[None])[0]
        turn, shift = shot.camera_from_world[:3, :3], shot.camera_from_world[:3, 3]
        ray = turn.T @ np.linalg.solve(shot.camera.matrix, [x, y, 1])
        directions.append(ray / np.linalg.norm(ray))
        origins.append(-turn.T @ shift)
    directions = np.stack(directions)
    if (directions @ directions.T).min() > np.cos(np.radians(LEAST_ANGLE_DEG)):
        return None
    return nearest_point(np.stack(origins), directions)


def by_tags(shots: Sequence[Shot], tag_mm: float, family: str) -> float:
    """What the poses' translations must be multiplied by to be metres."""
    seen: dict[tuple[int, int], list] = defaultdict(list)
    for shot, tags in zip(shots, find_all([shot.photo for shot in shots], family)[0]):
        for tag, corners in zip(tags.ids.tolist(), tags.corners):
            for corner in range(4):
                seen[tag, corner].append((shot, corners[corner]))
    points = {key: triangulate(rays) for key, rays in seen.items() if len(rays) >= LEAST_TAGS_SEEN}
    sides = [
        float(np.linalg.norm(points[tag, corner] - points[tag, (corner + 1) % 4]))
        for tag, corner in points
        if points[tag, corner] is not None and points.get((tag, (corner + 1) % 4)) is not None
    ]
    if len(sides) < 4 * MIN_TAGS:
        raise DatasetError("--tag-mm: too few tags are seen from several sides to tell the scale of the poses")
    return tag_mm / 1000 / float(np.median(sides))


def by_points(shots: Sequence[Shot], path: Path) -> float:
    """The same."""
    by_name = {shot.photo.name: shot for shot in shots}
    try:
        values = json.loads(path.read_text())
        millimetres, ends = float(values["mm"]), []
        for end in ("a", "b"):
            rays = [(by_name[name], np.array(pixel, float).reshape(2)) for name, pixel in values[end].items()]
            ends.append(triangulate(rays) if len(rays) > 1 else None)
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}") from None
    except KeyError as error:
        raise DatasetError(f"{path}: no {error.args[0]!r}: needs a, b (pixels by photo) and mm") from None
    except (ValueError, TypeError, AttributeError) as error:
        raise DatasetError(f"{path}: {error}") from None
    if any(end is None for end in ends):
        raise DatasetError(f"{path}: click each point in two photos or more, from different sides")
    distance = float(np.linalg.norm(ends[0] - ends[1]))
    if distance <= 0 or millimetres <= 0:
        raise DatasetError(f"{path}: the two points are the same")
    return millimetres / 1000 / distance
