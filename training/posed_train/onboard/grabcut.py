"""Outlines from colours, by GrabCut (Rother and others, 2004), between a region that is surely the object and one that
surely is not."""

from dataclasses import dataclass

import cv2
import numpy as np

LONG_SIDE_PX = 320
ITERATIONS = 3
MARGIN = 0.25
"""Of the region's size, for the colours of what is around."""
LEAST_PART = 0.08
"""Of the whole: smaller pieces are dropped."""
MIN_KNOWN_PX = 12


@dataclass(frozen=True)
class Window:
    """A part of a photo, at the scale that outlines are found in."""

    left: int
    top: int
    right: int
    bottom: int
    scale: float

    @staticmethod
    def around(outline: np.ndarray, width: int, height: int) -> "Window | None":
        """None where nothing of the outline `[N, 2]` is in the photo."""
        low, high = outline.min(0), outline.max(0)
        margin = MARGIN * (high - low).max() + 6
        left, top = np.maximum(np.floor(low - margin), 0).astype(int)
        right, bottom = np.minimum(np.ceil(high + margin) + 1, [width, height]).astype(int)
        if right - left < 4 or bottom - top < 4:
            return None
        return Window(left, top, right, bottom, min(1.0, LONG_SIDE_PX / max(right - left, bottom - top)))

    @property
    def size(self) -> tuple[int, int]:
        return max(1, round((self.right - self.left) * self.scale)), max(
            1, round((self.bottom - self.top) * self.scale)
        )

    def cut(self, image: np.ndarray) -> np.ndarray:
        part = image[self.top : self.bottom, self.left : self.right]
        return cv2.resize(part, self.size, interpolation=cv2.INTER_AREA) if self.scale < 1 else part.copy()

    def to_window(self, pixels: np.ndarray) -> np.ndarray:
        return (pixels - [self.left, self.top] + 0.5) * self.scale - 0.5

    def paste(self, mask: np.ndarray, width: int, height: int) -> np.ndarray:
        """The window's mask as one of the whole photo."""
        whole = np.zeros((height, width), np.uint8)
        full = cv2.resize(mask, (self.right - self.left, self.bottom - self.top), interpolation=cv2.INTER_LINEAR)
        whole[self.top : self.bottom, self.left : self.right] = (full > 127) * np.uint8(255)
        return whole


def segment(
    image: np.ndarray, inside: np.ndarray, outside: np.ndarray, likely: np.ndarray, seed: int
) -> np.ndarray | None:
    """The object's mask (0, 255) in a BGR window. Masks of where it surely is, surely is not, and likely is; None where
    they leave too little to learn colours from."""
    labels = np.where(likely > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[inside > 0] = cv2.GC_FGD
    labels[outside > 0] = cv2.GC_BGD
    if min((labels == cv2.GC_BGD).sum(), np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).sum()) < MIN_KNOWN_PX:
        return None
    if not np.isin(labels, (cv2.GC_PR_BGD, cv2.GC_PR_FGD)).any():
        return inside
    cv2.setRNGSeed(seed)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    try:
        cv2.grabCut(image, labels, None, *models, ITERATIONS, cv2.GC_INIT_WITH_MASK)
    except cv2.error:  # all pixels of one colour
        return None
    return tidy(np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.uint8) * 255)


def tidy(mask: np.ndarray) -> np.ndarray:
    """Without holes and small pieces."""
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    if count > 2:
        areas = stats[1:, cv2.CC_STAT_AREA]
        kept = 1 + np.flatnonzero(areas >= LEAST_PART * areas.sum())
        mask = np.isin(pieces, kept).astype(np.uint8) * 255
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return cv2.drawContours(np.zeros_like(mask), outlines, -1, 255, cv2.FILLED)


def band(projection: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Where an object surely is and surely is not, its outline being uncertain by a share of its size."""
    radius = max(1.0, share * np.sqrt(max(1, int((projection > 0).sum()))))
    from_edge = cv2.distanceTransform(projection, cv2.DIST_L2, 5)
    from_object = cv2.distanceTransform(255 - projection, cv2.DIST_L2, 5)
    return (from_edge > radius) * np.uint8(255), (from_object > radius) * np.uint8(255)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks."""
    union = np.logical_or(a, b).sum()
    return float(np.logical_and(a, b).sum() / union) if union else 0.0
