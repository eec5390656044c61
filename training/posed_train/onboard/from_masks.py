"""Labels as masks: a PNG a photo, named as it is; with several objects, a folder of them for each."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from ..bop import DatasetError
from .given import Given, of_mask

MOSTLY_WHITE = 0.85
"""Share of a photo that no object covers in most photos: then black is the object."""


def read_masks(folder: Path, names: Sequence[str]) -> list[Given]:
    """`names` are the project's objects."""
    if not folder.is_dir():
        raise DatasetError(f"{folder}: give the folder of masks")
    by_object = {name: folder / name for name in names if (folder / name).is_dir()}
    if not by_object:
        if len(names) > 1:
            raise DatasetError(f"{folder}: give each object's masks a folder of its name: {', '.join(names)}")
        by_object = {names[0]: folder}
    found = []
    for name, place in by_object.items():
        read = [(path, read_mask(path)) for path in sorted(place.glob("*.png"))]
        if not read:
            raise DatasetError(f"{place}: no PNG files")
        if np.median([(mask > 0).mean() for _, mask in read]) > MOSTLY_WHITE:
            raise DatasetError(f"{place}: most of the masks is white: are they inverted? White is the object")
        found += [one for path, mask in read if (one := of_mask(mask, str(path), path.stem, name)) is not None]
    return found


def read_mask(path: Path) -> np.ndarray:
    mask = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if mask is None:
        raise DatasetError(f"{path}: not a readable image")
    if mask.ndim == 3:
        colours = mask[..., :3]
        if (colours != colours[..., :1]).any():
            raise DatasetError(f"{path}: has colours; a mask is black and white, one for each object")
        mask = colours[..., 0]
    values = np.unique(mask)
    if len(values) > 2 and not smooth(values):
        raise DatasetError(
            f"{path}: holds the values {', '.join(map(str, values[:8]))}: numbers of objects? Give each object masks "
            "of its own, black and white"
        )
    return ((mask > values.max() / 2) * 255).astype(np.uint8) if values.max() else np.zeros(mask.shape, np.uint8)


def smooth(values: np.ndarray) -> bool:
    """Grey edges between black and white, not numbers of objects."""
    return bool(values.max() >= 255 and values.min() == 0)
