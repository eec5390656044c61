"""Pictures to paste objects on where the user has none: textures, and what the photos show beyond the objects."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from ..bop import View, read_rgb, write_rgb

SIZE_PX = 360
TEXTURES = 60
CROPS = 60
TRIES = 12
LEAST_SHARE, MOST_SHARE = 0.25, 0.6
"""Of the photo's shorter side."""


def make_backgrounds(views: Sequence[View], every_box: dict[Path, list], folder: Path, seed: int = 1) -> int:
    """Writes them unless the folder has some; returns how many there are. `every_box`: of all objects, by image."""
    folder.mkdir(parents=True, exist_ok=True)
    if not any(folder.glob("*.jpg")):
        rng = np.random.default_rng(seed)
        pictures = [texture(rng) for _ in range(TEXTURES)] + crops(views, every_box, rng)
        for number, picture in enumerate(pictures):
            write_rgb(folder / f"made-{number:03d}.jpg", picture)
    return len(list(folder.glob("*.jpg")))


def texture(rng: np.random.Generator) -> np.ndarray:
    """Noise of several scales between two colours, or stripes."""
    first, second = rng.integers(0, 256, (2, 3))
    field = np.zeros((SIZE_PX, SIZE_PX))
    for cells in (3, 9, 27, 81):
        noise = rng.random((cells, cells)).astype(np.float32)
        field += rng.uniform(0, 1) * cv2.resize(noise, (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_CUBIC)
    if rng.random() < 0.3:
        x, y = np.meshgrid(*[np.linspace(0, 1, SIZE_PX)] * 2)
        angle, count = rng.uniform(0, np.pi), rng.integers(3, 40)
        field += (np.sin(2 * np.pi * count * (x * np.cos(angle) + y * np.sin(angle))) > 0) * rng.uniform(0.5, 2)
    share = ((field - field.min()) / max(np.ptp(field), 1e-9))[..., None]
    return (first * (1 - share) + second * share).astype(np.uint8)


def crops(views: Sequence[View], every_box: dict[Path, list], rng: np.random.Generator) -> list[np.ndarray]:
    """Squares of photos that touch no object's box."""
    found = []
    for index in rng.permutation(len(views))[: 2 * CROPS]:
        path = views[index].image_path
        image = read_rgb(path)
        height, width = image.shape[:2]
        for _ in range(TRIES):
            side = int(rng.uniform(LEAST_SHARE, MOST_SHARE) * min(width, height))
            left, top = rng.integers(0, width - side + 1), rng.integers(0, height - side + 1)
            apart = [
                x >= left + side or y >= top + side or x + w <= left or y + h <= top for x, y, w, h in every_box[path]
            ]
            if all(apart):
                part = image[top : top + side, left : left + side]
                found.append(cv2.resize(part, (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_AREA))
                break
        if len(found) == CROPS:
            break
    return found
