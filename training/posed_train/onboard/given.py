"""Labels that other tools have stored, and how their outlines become masks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..bop import DatasetError

FINE = 4
"""Outlines are drawn at so many times the size: a pixel counts that is half inside."""


@dataclass(frozen=True)
class Given:
    """One object in one image. Pixels as other tools have them: (0, 0) is the corner of the first pixel."""

    where: str
    """File and place in it, for messages."""
    image: str
    """Its file's name, or the stem of it."""
    category: str
    box: np.ndarray  # [4] left, top, right, bottom
    size: tuple[int, int] | None
    """Width and height of the image, if the tool stored them; else the box is in shares of them."""
    mask: Callable[[int, int], np.ndarray] | None = None
    """Draws what is seen of it, 0 or 255, for an image of this width and height."""


def of_polygons(
    polygons: Sequence[np.ndarray], where: str, image: str, category: str, size: tuple[int, int] | None
) -> Given:
    """`polygons` `[N, 2]`, in shares of width and height where the size is not known."""
    if not polygons or any(len(polygon) < 3 for polygon in polygons):
        raise DatasetError(f"{where}: an outline needs three points or more")
    points = np.concatenate(polygons)
    if not np.isfinite(points).all():
        raise DatasetError(f"{where}: an outline's point is not a number")

    def draw(width: int, height: int) -> np.ndarray:
        scale = np.array([1.0, 1.0]) if size else np.array([width, height], float)
        return fill([polygon * scale for polygon in polygons], width, height)

    return Given(where, image, category, np.concatenate([points.min(0), points.max(0)]), size, draw)


def of_box(box: Sequence[float], where: str, image: str, category: str, size: tuple[int, int] | None) -> Given:
    """x, y, width and height."""
    values = np.array(box, float)
    if values.shape != (4,) or not np.isfinite(values).all() or min(values[2:]) <= 0:
        raise DatasetError(f"{where}: a box needs x, y, and a width and height above 0, not {list(box)}")
    return Given(where, image, category, np.concatenate([values[:2], values[:2] + values[2:]]), size)


def of_mask(mask: np.ndarray, where: str, image: str, category: str) -> Given | None:
    """None where it is empty."""
    x, y, w, h = cv2.boundingRect(mask)
    if not w:
        return None
    whole = (mask > 0) * np.uint8(255)
    box = np.array([x, y, x + w, y + h], float)
    return Given(where, image, category, box, mask.shape[1::-1], lambda width, height: whole)


def fill(polygons: Sequence[np.ndarray], width: int, height: int) -> np.ndarray:
    """Their union: a pixel counts that is half inside."""
    mask = np.zeros((height, width), np.uint8)
    points = np.concatenate(polygons)
    left, top = np.clip(np.floor(points.min(0)), 0, [width, height]).astype(int)
    right, bottom = np.clip(np.ceil(points.max(0)), 0, [width, height]).astype(int)
    if right <= left or bottom <= top:
        return mask
    fine = np.zeros((FINE * (bottom - top), FINE * (right - left)), np.uint8)
    for polygon in polygons:
        moved = np.clip((polygon - [left, top]) * FINE - 0.5, -30_000, 30_000)
        cv2.fillPoly(fine, [np.round(moved).astype(np.int32)], 255)
    part = cv2.resize(fine, (right - left, bottom - top), interpolation=cv2.INTER_AREA)
    mask[top:bottom, left:right] = (part > 127) * np.uint8(255)
    return mask


def union(parts: Sequence[Given]) -> Given:
    """Parts of one object in one image."""
    first = parts[0]
    if len(parts) == 1:
        return first
    boxes = np.stack([part.box for part in parts])
    box = np.concatenate([boxes[:, :2].min(0), boxes[:, 2:].max(0)])
    if any(part.mask is None for part in parts):
        return Given(first.where, first.image, first.category, box, first.size)

    def draw(width: int, height: int) -> np.ndarray:
        return np.maximum.reduce([part.mask(width, height) for part in parts])

    return Given(first.where, first.image, first.category, box, first.size, draw)
