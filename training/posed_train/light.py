"""Another room's light on a crop: brighter on one side, coloured from one side, soft shadows."""

import cv2
import numpy as np

CELLS = 16
"""The light is smooth, and made at this resolution."""
SIDED_SHARE, COLOURED_SHARE, SHADOW_SHARE = 0.7, 0.4, 0.4


def light_field(size: int, rng: np.random.Generator) -> np.ndarray:
    """What to multiply a crop by, `[size, size, 3]`, about 1."""
    down, across = np.mgrid[-1 : 1 : CELLS * 1j, -1 : 1 : CELLS * 1j]

    def slope() -> np.ndarray:
        """From -1 to 1 across the crop, in any direction."""
        turn, bend = rng.uniform(-np.pi, np.pi), rng.uniform(1, 4)
        return np.tanh(bend * (np.cos(turn) * across + np.sin(turn) * down + rng.uniform(-0.4, 0.4)))[..., None]

    light = np.ones((CELLS, CELLS, 3))
    if rng.random() < SIDED_SHARE:
        light *= 1 + rng.uniform(0.1, 0.6) * slope()
    if rng.random() < COLOURED_SHARE:
        light *= 1 + (1 + slope()) / 2 * rng.normal(0, 0.25, 3)
    if rng.random() < SHADOW_SHARE:
        shade = cv2.GaussianBlur(rng.normal(size=(CELLS, CELLS)), (0, 0), rng.uniform(1.2, 3))
        shade = 1 / (1 + np.exp(-6 * (shade - np.quantile(shade, rng.uniform(0.3, 0.8))) / shade.std()))
        light *= 1 - rng.uniform(0.2, 0.7) * shade[..., None]
    light = np.clip(light, 0.1, 2.5) / max(0.5, float(light.mean()))
    return cv2.resize(light.astype(np.float32), (size, size), interpolation=cv2.INTER_LINEAR)
