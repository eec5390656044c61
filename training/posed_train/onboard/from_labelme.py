"""Labels of labelme: one JSON file an image."""

import base64
import binascii
import json
from collections import defaultdict
from pathlib import Path, PureWindowsPath

import cv2
import numpy as np

from ..bop import DatasetError
from .given import Given, of_box, of_mask, of_polygons, union

CIRCLE = 2 * np.pi * np.arange(64) / 64


def read_labelme(folder: Path) -> list[Given]:
    if not folder.is_dir():
        raise DatasetError(f"{folder}: give the folder of labelme's JSON files")
    found = []
    for path in sorted(folder.glob("*.json")):
        try:
            values = json.loads(path.read_text())
        except ValueError as error:
            raise DatasetError(f"{path}: not valid JSON ({error})") from None
        try:
            if isinstance(values, dict) and "shapes" in values:
                found += read_image(values, path)
        except (KeyError, TypeError, IndexError, AttributeError) as error:
            raise DatasetError(f"{path}: not a file of labelme's: {type(error).__name__} {error}") from None
    if not found:
        raise DatasetError(f"{folder}: no JSON file with labelme's shapes")
    return found


def read_image(values: dict, path: Path) -> list[Given]:
    """Shapes of one label and one group are parts of one object."""
    name, size = PureWindowsPath(values["imagePath"]).name, (int(values["imageWidth"]), int(values["imageHeight"]))
    parts: dict[tuple, list[Given]] = defaultdict(list)
    for number, shape in enumerate(values["shapes"]):
        one = read_shape(shape, f"{path}: shape {number}", name, size)
        if one is not None:
            group = shape.get("group_id")
            parts[one.category, number if group is None else f"group {group}"].append(one)
    return [union(found) for found in parts.values()]


def read_shape(shape: dict, where: str, name: str, size: tuple[int, int]) -> Given | None:
    label, kind = str(shape["label"]), shape.get("shape_type", "polygon")
    points = np.array(shape["points"], float).reshape(-1, 2)
    if kind == "polygon":
        return of_polygons([points], where, name, label, size)
    if kind == "rectangle" and len(points) in (2, 4):
        low, high = points.min(0), points.max(0)
        return of_box([*low, *(high - low)], where, name, label, size)
    if kind == "circle" and len(points) == 2:
        rim = np.column_stack([np.cos(CIRCLE), np.sin(CIRCLE)]) * np.linalg.norm(points[1] - points[0])
        return of_polygons([points[0] + rim], where, name, label, size)
    if kind == "mask":
        return of_mask(paste(shape, points, where, size), where, name, label)
    raise DatasetError(f"{where}: a {kind} is no outline; draw polygons, rectangles, circles or masks")


def paste(shape: dict, points: np.ndarray, where: str, size: tuple[int, int]) -> np.ndarray:
    """A mask is a PNG of what lies in its box."""
    try:
        content = np.frombuffer(base64.b64decode(shape["mask"], validate=True), np.uint8)
        part = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if len(content) else None
    except binascii.Error:
        part = None
    if part is None:
        raise DatasetError(f"{where}: its mask is not a PNG in base64")
    whole = np.zeros(size[::-1], np.uint8)
    left, top = np.round(points.min(0)).astype(int)
    if left < 0 or top < 0 or top + part.shape[0] > size[1] or left + part.shape[1] > size[0]:
        raise DatasetError(f"{where}: its mask reaches outside the image of {size[0]}x{size[1]} px")
    whole[top : top + part.shape[0], left : left + part.shape[1]] = part
    return whole
