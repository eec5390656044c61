"""What a camera's optics, sensor and encoder do to a crop. In the order in which they do it."""

from functools import cache

import cv2
import numpy as np

NOISE_SIDE = 512
READ_NOISE, SHOT_NOISE = (0.5, 7.0), 0.5
"""Standard deviation in the dark, levels, and variance for each level of brightness at most."""


def vary_camera(crop: np.ndarray, rng: np.random.Generator, strength: float) -> np.ndarray:
    """`[H, W, 3]` float32 to uint8."""
    s = strength
    if rng.random() < 0.15 * s:
        crop = split_colours(crop, rng)
    if rng.random() < 0.4 * s:
        crop = cv2.GaussianBlur(crop, (0, 0), rng.uniform(0.3, 1.6))
    if rng.random() < 0.15 * s:
        crop = cv2.filter2D(crop, -1, motion(rng.uniform(2, 8), rng.uniform(0, np.pi)))
    if rng.random() < 0.1 * s:
        crop = crop * flicker(len(crop), rng)
    # A sensor's pixels are full at the brightest, before there is noise.
    crop = np.clip(crop, 0, 255)
    if rng.random() < 0.5 * s:
        crop = crop + noise(crop, rng)
    if rng.random() < 0.35 * s:  # cameras sharpen: without this, photos seemed larger than renders by three percent
        soft = cv2.GaussianBlur(crop, (0, 0), rng.uniform(0.5, 1.5))
        crop = cv2.addWeighted(crop, 1 + (amount := rng.uniform(0.3, 2.5)), soft, -amount, 0)
    crop = np.clip(crop, 0, 255).astype(np.uint8)
    return compress(crop, int(rng.integers(25, 95))) if rng.random() < 0.3 * s else crop


def split_colours(crop: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Red and blue a little larger or smaller than green, and beside it: chromatic aberration."""
    size, shift = np.array(crop.shape[1::-1]), rng.normal(0, 0.6, 2)
    grown = rng.normal(0, 0.004)
    channels = list(cv2.split(crop))
    for channel, sign in ((0, 1), (2, -1)):
        scale = 1 + sign * grown
        moved = (1 - scale) * (size - 1) / 2 + sign * shift
        affine = np.array([[scale, 0, moved[0]], [0, scale, moved[1]]])
        channels[channel] = cv2.warpAffine(
            channels[channel], affine, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return cv2.merge(channels)


def motion(length: float, turn: float) -> np.ndarray:
    """The kernel of a straight motion of so many pixels."""
    reach = int(np.ceil(length / 2)) + 1
    down, across = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    along, beside = across * np.cos(turn) + down * np.sin(turn), down * np.cos(turn) - across * np.sin(turn)
    kernel = np.clip(length / 2 + 0.5 - np.abs(along), 0, 1) * np.clip(1 - np.abs(beside), 0, 1)
    return (kernel / kernel.sum()).astype(np.float32)


def flicker(size: int, rng: np.random.Generator) -> np.ndarray:
    """Brightness by rows, as lamps on mains make it under a rolling shutter, `[size, 1, 1]`."""
    phase = 2 * np.pi * (np.arange(size) / rng.uniform(0.5 * size, 4 * size) + rng.random())
    return (1 + rng.uniform(0.05, 0.25) * np.sin(phase)).astype(np.float32)[:, None, None]


def noise(crop: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A sensor's: more variance where there is more light. Half the time blurred, as colours are interpolated."""
    dark, bright = rng.uniform(*READ_NOISE), rng.uniform(0, SHOT_NOISE)
    height, width = crop.shape[:2]
    top, left = rng.integers(NOISE_SIDE - height + 1), rng.integers(NOISE_SIDE - width + 1)
    drawn = normal_noise(bool(rng.random() < 0.5))[top : top + height, left : left + width]
    return drawn * cv2.sqrt(crop * float(bright) + float(dark**2))


@cache
def normal_noise(blurred: bool) -> np.ndarray:
    """`[NOISE_SIDE, NOISE_SIDE, 3]` of standard deviation 1, of which crops take a part: drawing it costs more than all
    else."""
    drawn = np.random.default_rng(0).standard_normal((NOISE_SIDE, NOISE_SIDE, 3), np.float32)
    drawn = cv2.GaussianBlur(drawn, (0, 0), 0.7) if blurred else drawn
    return drawn / drawn.std()


def compress(crop: np.ndarray, quality: int) -> np.ndarray:
    """As JPEG does."""
    encoded = cv2.imencode(".jpg", cv2.cvtColor(crop, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return cv2.imdecode(encoded, cv2.IMREAD_COLOR_RGB)
