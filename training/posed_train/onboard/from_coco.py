"""Labels of a COCO file: boxes, outlines, and masks as run lengths."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from .given import Given, of_box, of_mask, of_polygons


def read_coco(path: Path) -> list[Given]:
    try:
        values = json.loads(path.read_text())
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise DatasetError(f"{path}: not valid JSON ({error})") from None
    parts = [values.get(name) if isinstance(values, dict) else None for name in ("images", "annotations", "categories")]
    if not all(isinstance(part, list) for part in parts):
        raise DatasetError(f"{path}: a COCO file has images, annotations and categories")
    try:
        images = {image["id"]: image for image in parts[0]}
        names = {category["id"]: str(category["name"]) for category in parts[2]}
        found = [read_annotation(one, images, names, path) for one in parts[1] if not one.get("iscrowd")]
    except (KeyError, TypeError, AttributeError) as error:
        raise DatasetError(f"{path}: not a COCO file: {type(error).__name__} {error}") from None
    return [one for one in found if one is not None]


def read_annotation(one: dict, images: dict, names: dict, path: Path) -> Given | None:
    where = f"{path}: annotation {one['id']}"
    if one["image_id"] not in images:
        raise DatasetError(f"{where}: no image has the id {one['image_id']}")
    if one["category_id"] not in names:
        raise DatasetError(f"{where}: no category has the id {one['category_id']}")
    image, category = images[one["image_id"]], names[one["category_id"]]
    size, name = (int(image["width"]), int(image["height"])), str(image["file_name"])
    outline = one.get("segmentation")
    if isinstance(outline, dict):
        return of_mask(decode(outline, where), where, name, category)
    if outline:
        return of_polygons([pairs(flat, where) for flat in outline], where, name, category, size)
    return of_box(one["bbox"], where, name, category, size)


def pairs(flat: Sequence[float], where: str) -> np.ndarray:
    values = np.array(flat, float)
    if values.ndim != 1 or len(values) % 2:
        raise DatasetError(f"{where}: an outline is a flat list of x and y")
    return values.reshape(-1, 2)


def decode(outline: dict, where: str) -> np.ndarray:
    """Run lengths of 0 and 1 by turns, down the columns."""
    height, width = (int(side) for side in outline["size"])
    counts = outline["counts"]
    if isinstance(counts, str):
        counts = decompress(counts, where)
    lengths = np.array(counts, int)
    if lengths.min(initial=0) < 0 or lengths.sum() != width * height or width * height > 1 << 28:
        raise DatasetError(f"{where}: its run lengths do not fill {width}x{height} px")
    values = np.repeat(np.arange(len(lengths)) % 2 == 1, lengths)
    return np.ascontiguousarray(values.reshape(width, height).T).astype(np.uint8) * 255


def decompress(text: str, where: str) -> list[int]:
    """COCO's own writing of run lengths: five bits a character, and from the fourth on the difference to the one but
    last."""
    counts: list[int] = []
    value, shift = 0, 0
    for character in text:
        bits = ord(character) - 48
        if not 0 <= bits < 64:
            raise DatasetError(f"{where}: {character!r} in its run lengths is none of COCO's characters")
        value |= (bits & 31) << shift
        shift += 5
        if bits & 32:
            continue
        if bits & 16:
            value -= 1 << shift
        counts.append(value + (counts[-2] if len(counts) > 2 else 0))
        value, shift = 0, 0
    return counts
