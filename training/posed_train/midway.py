"""Whether something changed midway through a series of photos, and after which of them."""

import cv2
import numpy as np

LEAST = 5
"""Photos on either side."""
ONE_LEVEL = 0.85
"""Share of the photos of a side that must lie on its level."""
APART = 0.5
"""The lower level is below that share of the higher one."""
RING = 0.25
"""Width of the surroundings that an object is compared with, of its size."""
RIM_PX = 2
"""Of an outline: belongs to neither."""
BINS = 8
LEAST_AREA_PX = 100


def change(values: np.ndarray) -> int | None:
    """The first photo after the change, by a value of each that lies on one level before and on another after it."""
    best, where = 0.0, None
    for k in range(LEAST, len(values) - LEAST + 1):
        before, after = np.median(values[:k]), np.median(values[k:])
        high, low = (values[:k], values[k:]) if before > after else (values[k:], values[:k])
        ratio = np.median(low) / max(np.median(high), 1e-12)
        between = (np.median(high) + np.median(low)) / 2
        share = min(np.mean(high > between), np.mean(low < between))
        if ratio < APART and share >= ONE_LEVEL and share * (1 - ratio) > best:
            best, where = share * (1 - ratio), k
    return where


def contrast(image: np.ndarray, mask: np.ndarray, others: np.ndarray) -> float | None:
    """How unlike the colours within a mask are to those around it, 0 to 1; `others` are masks of other objects. About 0
    where the object is not there, or looks as what it lies on. None where it is too small to tell."""
    x, y, w, h = cv2.boundingRect(mask)
    side = float(np.sqrt((mask > 0).sum()))
    if side**2 < LEAST_AREA_PX:
        return None
    room = max(3, round(RING * side))
    part = np.s_[max(0, y - room - 1) : y + h + room + 1, max(0, x - room - 1) : x + w + room + 1]
    rim, wide = (np.ones((2 * size + 1, 2 * size + 1), np.uint8) for size in (RIM_PX, room))
    inside = cv2.erode(mask[part], rim)
    around = cv2.dilate(mask[part], wide) & ~cv2.dilate(mask[part], rim) & ~others[part]
    if not inside.any() or not around.any():
        return None
    colours = cv2.cvtColor(np.ascontiguousarray(image[part]), cv2.COLOR_BGR2LAB)
    a, b = histogram(colours, inside), histogram(colours, around)
    return float(1 - np.sqrt(a * b).sum())


def histogram(colours: np.ndarray, mask: np.ndarray) -> np.ndarray:
    counts = cv2.calcHist([colours], [0, 1, 2], mask, [BINS] * 3, [0, 256] * 3).ravel()
    return counts / counts.sum()
