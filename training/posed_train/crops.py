"""Square crops around boxes. The service cuts them the same way (`src/vision/crop.rs`); parity tests hold both to it.

A crop is the square of side `CROP_SCALE * max(w, h)` about the box centre. Its map to pixels is the affine
`crop_from_image`: pixel centres are at integer coordinates, so the square's left edge lies at `x - 0.5`.

The net looks twice: into a crop around the box, then into one around the keypoints it found there. The first box errs
as detectors do, and shrinks where the object is half hidden; the second does neither.
"""

from dataclasses import dataclass

import numpy as np
from PIL import Image

from .bop import View, read_mask, read_rgb

CROP_SCALE = 1.5
ZOOM = 2.75
"""Side of the second box over the root mean square distance of the keypoints from their centre."""
ZOOMED_PER_BOX = (0.5, 2.5)
"""A second look is taken at a place whose side is about that of the box: elsewhere the first one went wrong."""
PATCH_SCALE = 2.4  # what training keeps around the object: room for rotation and box noise
PATCH_PER_INPUT = 1.5  # pixels of a patch for one of the network's input: a patch is not blurred by being cut again


@dataclass(frozen=True)
class Square:
    """A square region of an image; `left` and `top` are edges, in pixel-edge coordinates (0 = image border)."""

    left: float
    top: float
    side: float

    @classmethod
    def around(cls, box: tuple[float, float, float, float], scale: float) -> "Square":
        x, y, w, h = box
        side = scale * max(w, h)
        return cls(x + w / 2 - side / 2, y + h / 2 - side / 2, side)

    @classmethod
    def about(cls, keypoints: np.ndarray) -> "Square":
        """The second box: about keypoints `[N, 2]`, image pixels."""
        centre = keypoints.mean(0)
        side = ZOOM * np.sqrt(((keypoints - centre) ** 2).sum(-1).mean())
        return cls(*(centre + 0.5 - side / 2), side)

    @property
    def centre(self) -> np.ndarray:
        """`[2]` pixels."""
        return np.array([self.left, self.top]) + self.side / 2 - 0.5

    def scaled(self, factor: float) -> "Square":
        """About the same centre."""
        margin = self.side * (factor - 1) / 2
        return Square(self.left - margin, self.top - margin, self.side * factor)

    def within(self, whole: "Square", size: int) -> "Square":
        """The same place in the pixels of `whole`, cut to `size`."""
        scale = size / whole.side
        return Square((self.left - whole.left) * scale, (self.top - whole.top) * scale, self.side * scale)

    def to_crop(self, pixels: np.ndarray, size: int) -> np.ndarray:
        """Image pixels to crop pixels, both with centres at integers."""
        return (pixels + 0.5 - [self.left, self.top]) * (size / self.side) - 0.5

    def crop_from_image(self, size: int) -> np.ndarray:
        """The same map as a matrix `[3, 3]`."""
        scale = size / self.side
        shift = [(0.5 - self.left) * scale - 0.5, (0.5 - self.top) * scale - 0.5]
        return np.array([[scale, 0, shift[0]], [0, scale, shift[1]], [0, 0, 1]])

    def to_image(self, pixels: np.ndarray, size: int) -> np.ndarray:
        """The inverse of `to_crop`."""
        return (pixels + 0.5) * (self.side / size) - 0.5 + [self.left, self.top]

    def cut(self, image: np.ndarray, size: int) -> np.ndarray:
        """Bilinear with antialiasing (Pillow); what lies outside the image is black."""
        height, width = image.shape[:2]
        x0, y0 = int(np.floor(self.left)), int(np.floor(self.top))
        x1, y1 = int(np.ceil(self.left + self.side)), int(np.ceil(self.top + self.side))
        canvas = np.zeros((y1 - y0, x1 - x0, *image.shape[2:]), image.dtype)
        sx, sy = slice(max(x0, 0), min(x1, width)), slice(max(y0, 0), min(y1, height))
        if sx.start < sx.stop and sy.start < sy.stop:
            canvas[sy.start - y0 : sy.stop - y0, sx.start - x0 : sx.stop - x0] = image[sy, sx]
        left, top = self.left - x0, self.top - y0
        box = (left, top, min(left + self.side, x1 - x0), min(top + self.side, y1 - y0))
        return np.asarray(Image.fromarray(canvas).resize((size, size), Image.Resampling.BILINEAR, box=box))


@dataclass(frozen=True)
class Patch:
    """A view's surroundings at training resolution, with the keypoints' targets in patch pixels."""

    rgb: np.ndarray  # [P, P, 3] uint8
    mask: np.ndarray | None  # [P, P] uint8
    keypoints: np.ndarray  # [symmetries, N, 2]
    patch_from_image: np.ndarray  # [3, 3] pixels
    box: Square  # what a first crop is cut around, patch pixels
    zoomed: Square | None  # what a second one is cut around, if there will be any


def cut_patch(view: View, keypoints_in_image: np.ndarray | None, input_size: int, with_mask: bool) -> Patch:
    """With keypoints `[symmetries, N, 2]`, of which any tells where they are as a whole, or none (pairwise losses)."""
    size = round(PATCH_PER_INPUT * input_size)
    box = Square.around(view.box, 1.0)
    zoomed = None if keypoints_in_image is None else Square.about(keypoints_in_image[0])
    whole = (zoomed or box).scaled(PATCH_SCALE)
    mask = read_mask(view) if with_mask else None
    return Patch(
        rgb=whole.cut(read_rgb(view.image_path), size),
        mask=None if mask is None else whole.cut(mask, size),
        keypoints=np.zeros((1, 1, 2)) if keypoints_in_image is None else whole.to_crop(keypoints_in_image, size),
        patch_from_image=whole.crop_from_image(size),
        box=box.within(whole, size),
        zoomed=zoomed and zoomed.within(whole, size),
    )


def cut_crops(view: View, image: np.ndarray, size: int, ensemble: tuple[float, ...]) -> tuple[np.ndarray, list[Square]]:
    """The crops `[E, S, S, 3]` around this view's box."""
    return crops_around(Square.around(view.box, 1.0), image, size, ensemble)


def crops_around(
    box: Square, image: np.ndarray, size: int, ensemble: tuple[float, ...]
) -> tuple[np.ndarray, list[Square]]:
    squares = [box.scaled(CROP_SCALE * factor) for factor in ensemble]
    return np.stack([square.cut(image, size) for square in squares]), squares


def look_closer(keypoints: np.ndarray, box: Square) -> Square | None:
    """Where to look again after finding keypoints `[N, 2]` in a crop around `box`, image pixels; `None` where that is
    no place for the object of this box."""
    zoomed = Square.about(keypoints)
    near = np.abs(zoomed.centre - box.centre).max() <= box.side
    least, most = ZOOMED_PER_BOX
    return zoomed if near and least <= zoomed.side / box.side <= most else None
