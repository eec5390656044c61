"""Square crops around boxes. The service cuts them alike (`src/vision/crop.rs`); parity tests hold both to it.

A crop is the square of side `CROP_SCALE * max(w, h)` about the box centre. Its map to pixels is the affine
`crop_from_image`: pixel centres are at integer coordinates, so the square's left edge lies at `x - 0.5`.

The net looks twice: into a crop around the box, then into one around the keypoints it found there. The first box errs
as detectors do, and shrinks where the object is half hidden; the second does neither. Keypoints that then lie elsewhere
than the crop was cut for are followed. The second crop is also turned so that the object stands upright in it (an axis
of it points up): of the three degrees of freedom of its rotation the net need learn but two.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from PIL import Image

from .bop import View, read_mask, read_rgb

CROP_SCALE = 1.5
ZOOM = 2.75
"""Side of the second box over the root mean square distance of the keypoints from their centre."""
ZOOMED_PER_BOX = (0.5, 2.5)
"""A second look is taken at a place whose side is about that of the box: elsewhere the first one went wrong."""
ELSEWHERE = 0.03
"""By how much the size and the centre of two places differ, of their size, for the second to be elsewhere."""
WHOLE = 0.95
"""Least visible fraction of an object that counts as whole."""
PATCH_SCALE = 2.4  # what training keeps around the object: room for rotation and box noise
PATCH_PER_INPUT = 1.5  # pixels of a patch for one of the network's input: a patch is not blurred by being cut again


@dataclass(frozen=True)
class Square:
    """A square region of an image; `left` and `top` are the edges that it has when not turned, in pixel-edge
    coordinates (0 = image border)."""

    left: float
    top: float
    side: float
    turn: float = 0.0
    """By how much the image is turned about the square's centre before it is cut, radians, clockwise."""

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
        return replace(self, left=self.left - margin, top=self.top - margin, side=self.side * factor)

    def turned(self, angle: float) -> "Square":
        """About the same centre, by so many radians more."""
        return replace(self, turn=self.turn + angle)

    def within(self, whole: "Square", size: int) -> "Square":
        """The same place in the pixels of `whole`, which is not turned, cut to `size`."""
        scale = size / whole.side
        left, top = (self.left - whole.left) * scale, (self.top - whole.top) * scale
        return Square(left, top, self.side * scale, self.turn)

    def crop_from_image(self, size: int) -> np.ndarray:
        """Image pixels to crop pixels, both with centres at integers, `[3, 3]`."""
        cos, sin = np.array([np.cos(self.turn), np.sin(self.turn)]) * (size / self.side)
        linear = np.array([[cos, -sin], [sin, cos]])
        return as_matrix(np.column_stack([linear, (size - 1) / 2 - linear @ self.centre]))

    def to_crop(self, pixels: np.ndarray, size: int) -> np.ndarray:
        """Image pixels `[..., 2]` to crop pixels."""
        return transform(self.crop_from_image(size), pixels)

    def to_image(self, pixels: np.ndarray, size: int) -> np.ndarray:
        """The inverse of `to_crop`."""
        return transform(np.linalg.inv(self.crop_from_image(size)), pixels)

    def cut(self, image: np.ndarray, size: int) -> np.ndarray:
        """Bilinear with antialiasing (Pillow); what lies outside the image is black. A turned square is cut from an
        upright one of the same resolution that holds it."""
        if self.turn:
            reach = abs(np.cos(self.turn)) + abs(np.sin(self.turn))
            upright_size = int(np.ceil(size * reach))
            upright = replace(self.scaled(upright_size / size), turn=0.0)
            crop_from_upright = self.crop_from_image(size) @ np.linalg.inv(upright.crop_from_image(upright_size))
            return cv2.warpAffine(upright.cut(image, upright_size), crop_from_upright[:2], (size, size))
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


def as_matrix(affine: np.ndarray) -> np.ndarray:
    """`[2, 3]` to `[3, 3]`."""
    return np.vstack([affine, [0, 0, 1]])


def transform(affine: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    return pixels @ affine[:2, :2].T + affine[:2, 2]


def axis_in_image(keypoints: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Where an axis of the keypoints' own frame points in the image, `[2]`: `keypoints` are `[N, 2]` pixels, `heights`
    `[N]` their coordinates along it. Its length means nothing by itself."""
    return heights @ (keypoints - keypoints.mean(0))


def upright(axis: np.ndarray) -> float:
    """The turn after which this direction points up."""
    return float(np.arctan2(-axis[0], -axis[1]))


@dataclass(frozen=True)
class Patch:
    """A view's surroundings at training resolution, with the keypoints' targets in patch pixels."""

    rgb: np.ndarray  # [P, P, 3] uint8
    mask: np.ndarray | None  # [P, P] uint8
    keypoints: np.ndarray  # [symmetries, N, 2]
    patch_from_image: np.ndarray  # [3, 3] pixels
    border: tuple[float, float, float, float]  # left, top, right, bottom of the photo, patch pixels; beyond is black
    box: Square  # what a first crop is cut around, patch pixels
    whole: bool = True  # nothing hides the object


def cut_patch(view: View, keypoints_in_image: np.ndarray | None, input_size: int, with_mask: bool) -> Patch:
    """With keypoints `[symmetries, N, 2]`, of which any tells where they are as a whole, or none (pairwise losses)."""
    size = round(PATCH_PER_INPUT * input_size)
    box = Square.around(view.box, 1.0)
    whole = (box if keypoints_in_image is None else Square.about(keypoints_in_image[0])).scaled(PATCH_SCALE)
    mask = read_mask(view) if with_mask else None
    rgb = read_rgb(view.image_path)
    corners = whole.to_crop(np.array([[-0.5, -0.5], [rgb.shape[1] - 0.5, rgb.shape[0] - 0.5]]), size)
    return Patch(
        rgb=whole.cut(rgb, size),
        mask=None if mask is None else whole.cut(mask, size),
        keypoints=np.zeros((1, 1, 2)) if keypoints_in_image is None else whole.to_crop(keypoints_in_image, size),
        patch_from_image=whole.crop_from_image(size),
        border=tuple(corners.ravel()),
        box=box.within(whole, size),
        whole=view.visible_fraction >= WHOLE,
    )


@dataclass(frozen=True)
class Variant:
    """A crop beside others of the same place: a small net's errors differ from one to the next."""

    scale: float = 1.0
    turn_deg: float = 0.0


def crops_around(
    box: Square, image: np.ndarray, size: int, ensemble: tuple[Variant, ...] = (Variant(),)
) -> tuple[np.ndarray, list[Square]]:
    """The crops `[E, S, S, 3]` around a box."""
    squares = [box.scaled(CROP_SCALE * variant.scale).turned(np.radians(variant.turn_deg)) for variant in ensemble]
    return np.stack([square.cut(image, size) for square in squares]), squares


def first_crop(view: View, size: int) -> tuple[np.ndarray, Square]:
    """The crop `[S, S, 3]` around this view's box."""
    crops, squares = crops_around(Square.around(view.box, 1.0), read_rgb(view.image_path), size)
    return crops[0], squares[0]


def look_closer(keypoints: np.ndarray, heights: np.ndarray, box: Square) -> Square | None:
    """Where to look again after finding keypoints `[N, 2]` in a crop around `box`, image pixels; `None` where that is
    no place for the object of this box."""
    zoomed = Square.about(keypoints).turned(upright(axis_in_image(keypoints, heights)))
    near = np.abs(zoomed.centre - box.centre).max() <= box.side
    least, most = ZOOMED_PER_BOX
    return zoomed if near and least <= zoomed.side / box.side <= most else None


def elsewhere(closer: Square, place: Square) -> bool:
    """Whether keypoints lie so far from where a crop was cut for them that it is worth a look there."""
    moved = np.abs(closer.centre - place.centre).max() / place.side
    return max(moved, abs(np.log(closer.side / place.side))) > ELSEWHERE
