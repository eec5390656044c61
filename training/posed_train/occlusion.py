"""What stands behind an object, and what hides a part of it."""

from dataclasses import replace

import cv2
import numpy as np

from .crops import Patch, Square

CAMOUFLAGE_SHARE = 0.5
"""Of the pasted backgrounds: in the object's own colours."""
PLAIN_COVER_SHARE = 0.3
"""Of what hides an object: of one colour, not a photo."""
BLACK_SHARE = 0.5
"""Of what is plain: about black."""


class Surroundings:
    """Pictures of `size` to be put behind and before objects, of photos that are at least as large."""

    def __init__(self, photos: list[np.ndarray], rng: np.random.Generator, size: int):
        self.photos, self.rng, self.size = photos, rng, size

    def photo(self) -> np.ndarray:
        image = self.photos[self.rng.integers(len(self.photos))]
        side = int(self.rng.integers(self.size, min(image.shape[:2]) + 1))
        top = self.rng.integers(image.shape[0] - side + 1)
        left = self.rng.integers(image.shape[1] - side + 1)
        cut = cv2.resize(image[top : top + side, left : left + side], (self.size, self.size))
        return cut[:, ::-1] if self.rng.random() < 0.5 else cut

    def plain(self) -> np.ndarray:
        """One colour, often black. Beyond the photo's border is black, too: a net that sees black nowhere else takes
        an object before a black backdrop for one that is cut off."""
        rng = self.rng
        black = rng.random() < BLACK_SHARE
        colour = np.full(3, max(0.0, rng.uniform(-15, 15))) if black else rng.uniform(0, 255, 3)
        return np.broadcast_to(colour.astype(np.float32), (self.size, self.size, 3))

    def cover(self) -> np.ndarray:
        """Of something in front."""
        return self.plain() if self.rng.random() < PLAIN_COVER_SHARE else self.photo()

    def behind(self, own: np.ndarray) -> np.ndarray:
        """A background for an object whose pixels are `own` `[P, 3]`."""
        hard = len(own) > 0 and self.rng.random() < CAMOUFLAGE_SHARE
        return camouflage(own, (self.size, self.size), self.rng) if hard else self.photo()


def camouflage(own: np.ndarray, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Stripes or checks `[*shape, 3]` of a colour of the object, whose pixels are `own` `[P, 3]`, and another colour,
    often one of its own, too."""
    first, second = (own[rng.integers(len(own), size=2)] + rng.normal(0, 12, (2, 3))).astype(np.float32)
    if rng.random() < 0.6:
        second = rng.uniform(0, 255, 3).astype(np.float32)
    turn, period = rng.uniform(-np.pi, np.pi), rng.uniform(4, 40)
    across, down = np.arange(shape[1], dtype=np.float32)[None], np.arange(shape[0], dtype=np.float32)[:, None]
    cos, sin = float(np.cos(turn) / period), float(np.sin(turn) / period)
    starts = rng.uniform(0, 2, 2)
    cells = np.floor(cos * down - sin * across + float(starts[0]))
    if rng.random() < 0.6:
        cells += np.floor(sin * down + cos * across + float(starts[1]))
    mix = cv2.GaussianBlur(cells % 2, (0, 0), 0.6)[..., None]
    return first + (second - first) * mix


def cut_off(patch: Patch, rng: np.random.Generator) -> Patch:
    """Moves one side of the photo's border across the object."""
    pixels = np.argwhere(patch.mask > 127)[:, ::-1]
    if not len(pixels):
        return patch
    border, side = list(patch.border), rng.integers(4)
    hidden = rng.uniform(0.1, 0.6)
    border[side] = np.quantile(pixels[:, side % 2], hidden if side < 2 else 1 - hidden).round() + 0.5
    left, top, right, bottom = np.clip(np.ceil(border), 0, len(patch.mask)).astype(int)
    mask = np.zeros_like(patch.mask)
    mask[top:bottom, left:right] = patch.mask[top:bottom, left:right]
    return with_less(patch, mask, border=tuple(border))


def half_hide(patch: Patch, cover: np.ndarray, rng: np.random.Generator) -> Patch:
    """Puts a foreign plate before one side of the object. Its box shrinks, as it does where real things hide it."""
    size = len(patch.mask)
    pixels = np.argwhere(patch.mask > 127)[:, ::-1]
    if not len(pixels):
        return patch
    turn = rng.uniform(-np.pi, np.pi)
    towards, along = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    depths, widths = pixels @ towards, pixels @ along
    edge = np.quantile(depths, rng.uniform(0.4, 0.9))
    reach = np.ptp(widths)
    low, high = widths.min() - rng.uniform(-0.1, 0.5) * reach, widths.max() + rng.uniform(-0.1, 0.5) * reach
    far = depths.max() + rng.uniform(0, 0.6) * np.ptp(depths)
    corners = [d * towards + w * along for d, w in ((edge, low), (edge, high), (far, high), (far, low))]
    plate = np.zeros((size, size), np.uint8)
    cv2.fillConvexPoly(plate, np.round(corners).astype(np.int32), 255, cv2.LINE_AA)
    weight = plate[..., None].astype(np.float32) / 255
    rgb = patch.rgb * (1 - weight) + cv2.resize(cover, (size, size)) * weight
    return with_less(patch, cv2.min(patch.mask, 255 - plate), rgb=rgb.astype(np.uint8))


def with_less(patch: Patch, mask: np.ndarray, **changes) -> Patch:
    """The patch of which only so much is to be seen, its box with it; as it was where that is too little."""
    box = cv2.boundingRect(mask)
    if min(box[2:]) < 0.3 * max(box[2:]):  # a sliver, or nothing
        return patch
    return replace(patch, mask=mask, box=Square.around(box, 1.0), **changes)


def occlude(crop: np.ndarray, cover: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Covers a convex blob somewhere over the object."""
    size = len(crop)
    centre = rng.normal(size / 2, size / 4.5, 2)
    points = centre + rng.normal(0, size * rng.uniform(0.05, 0.16), (6, 2))
    blob = np.zeros((size, size), np.float32)
    cv2.fillConvexPoly(blob, cv2.convexHull(points.astype(np.int32)), 1.0, cv2.LINE_AA)
    return crop * (1 - blob[..., None]) + cover * blob[..., None]
