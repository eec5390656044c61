"""Training-time variation of a patch: geometry (box noise, in-plane rotation) here, and in which order the rest comes:
what hides it and what is behind it, light, colours, camera."""

from dataclasses import replace

import cv2
import numpy as np

from .camera import vary_camera
from .colour import MERGED_SHARE, merge_hues, vary_colour
from .crops import CROP_SCALE, ZOOM, Patch, Square, axis_in_image, transform, upright
from .light import light_field
from .occlusion import Surroundings, cut_off, half_hide, occlude

ZOOM_SHARE = 0.6
"""Of the crops: cut as for the second look."""
# Standard deviations of a crop's size and place, of the box's side: as detectors err, and as a first look does. The
# less, the better: a net is most exact where it has seen most.
BOX_NOISE = 0.08, 0.05
ZOOM_NOISE = 0.04, 0.03
TURN_NOISE = 0.1
"""Of the up axis' image in a first look, over its length when seen from the side: end on, it may point anywhere."""
PLAIN_SHARE = 0.1
"""Of the crops of whole objects, as long as training lasts: before one colour, often black."""
LIT_SHARE = 0.5
"""Of the crops: in another light, the object alone if it was pasted."""
HALF_HIDDEN_SHARE = 0.5
"""Of the crops, by a plate or by the photo's border, as long as training lasts: other variations fade since images to
come have less of them."""
# Standard deviations of a crop's rotation.
BOX_TURN_DEG, ZOOM_TURN_DEG = 25.0, 8.0
# Of a half-hidden object a first look errs by more. A net that never saw that takes the second crop's place for the
# truth where it cannot see: half of the crop's error went into the pose.
HIDDEN_ZOOM_NOISE, HIDDEN_ZOOM_TURN_DEG = (0.09, 0.05), 15.0


class Augmenter:
    """Turns patches into network inputs. `size` is its side; `backgrounds` are RGB images of at least this size;
    `heights` are the keypoints' coordinates along the axis that points up in second looks, if there are any.

    `strength` scales how often and how much everything varies. It starts at 1; lowering it towards the end of a
    training lets the net settle on images like those it will see. `pasted_share` is that of the crops that show the
    object before another background.
    """

    def __init__(
        self,
        backgrounds: list[np.ndarray],
        rng: np.random.Generator,
        size: int,
        heights: np.ndarray | None = None,
        pasted_share: float = 0.5,
    ):
        self.surroundings = Surroundings(backgrounds, rng, size) if backgrounds else None
        self.rng, self.size, self.heights, self.pasted_share = rng, size, heights, pasted_share
        self.strength = 1.0

    def __call__(self, patch: Patch) -> tuple[np.ndarray, np.ndarray]:
        """A crop `[S, S, 3]` uint8 and its map `crop_from_patch [2, 3]` of pixels."""
        rng, s, original = self.rng, self.strength, patch
        if self.surroundings and patch.mask is not None and rng.random() < HALF_HIDDEN_SHARE:
            hide = rng.random() < 0.5
            patch = half_hide(patch, self.surroundings.cover(), rng) if hide else cut_off(patch, rng)
        crop_from_patch = self.random_affine(patch, half_hidden=patch is not original)
        crop = self.warp(patch.rgb, crop_from_patch)
        mask = None if patch.mask is None else self.warp(patch.mask, crop_from_patch)
        if rng.random() < MERGED_SHARE * s:
            crop = merge_hues(crop, mask, rng)
        crop = self.place(crop, mask, whole=patch is original and patch.whole)
        if self.surroundings and rng.random() < 0.35 * s:
            crop = occlude(crop, self.surroundings.cover(), rng)
        crop = vary_colour(np.clip(crop, 0, 255).astype(np.uint8), rng, s)
        return self.blacken_beyond(patch.border, vary_camera(crop, rng, s), crop_from_patch), crop_from_patch

    def place(self, crop: np.ndarray, mask: np.ndarray | None, whole: bool) -> np.ndarray:
        """Before another background, in another light, both in a share of the crops."""
        rng, s = self.rng, self.strength
        light = light_field(self.size, rng) if rng.random() < LIT_SHARE * s else None
        chosen = rng.random()
        plain = whole and chosen < PLAIN_SHARE
        pasted = plain or PLAIN_SHARE < chosen < PLAIN_SHARE + self.pasted_share * s
        lit = crop if light is None else crop * light
        if not pasted or not self.surroundings or mask is None:
            return lit
        background = self.surroundings.plain() if plain else self.surroundings.behind(crop[mask > 127])
        weight = mask.astype(np.float32)[..., None] / 255
        return lit * weight + background * (1 - weight)

    def random_affine(self, patch: Patch, half_hidden: bool) -> np.ndarray:
        rng = self.rng
        if self.heights is not None and rng.random() < ZOOM_SHARE:
            noise, turn_deg = (HIDDEN_ZOOM_NOISE, HIDDEN_ZOOM_TURN_DEG) if half_hidden else (ZOOM_NOISE, ZOOM_TURN_DEG)
            box, (size_noise, place_noise) = self.second_box(patch), noise
            turn = rng.normal(0, np.radians(turn_deg))
        else:
            box, (size_noise, place_noise) = patch.box, BOX_NOISE
            whole = rng.random() < 0.15 * self.strength
            turn = rng.uniform(-np.pi, np.pi) if whole else rng.normal(0, np.radians(BOX_TURN_DEG))
        square = box.scaled(CROP_SCALE * np.exp(truncated_normal(rng, size_noise))).turned(turn)
        shift = box.side * np.array([truncated_normal(rng, place_noise) for _ in range(2)])
        return replace(square, left=square.left + shift[0], top=square.top + shift[1]).crop_from_image(self.size)[:2]

    def second_box(self, patch: Patch) -> Square:
        """As a first look's keypoints would have it; of a symmetric object they may be any of several."""
        keypoints, heights = patch.keypoints[self.rng.integers(len(patch.keypoints))], self.heights
        box = Square.about(keypoints)
        # Of keypoints on all sides the axis is as long as this where it is seen from the side.
        longest = box.side / ZOOM * np.linalg.norm(heights) * np.sqrt(len(heights) / 2)
        axis = axis_in_image(keypoints, heights) + self.rng.normal(0, TURN_NOISE * longest, 2)
        return box.turned(upright(axis))

    def warp(self, image: np.ndarray, affine: np.ndarray) -> np.ndarray:
        return cv2.warpAffine(image, affine, (self.size, self.size), flags=cv2.INTER_LINEAR)

    def blacken_beyond(
        self, border: tuple[float, float, float, float], crop: np.ndarray, affine: np.ndarray
    ) -> np.ndarray:
        """What lies outside the photo is black, whatever its light and background."""
        left, top, right, bottom = np.clip(border, -4 * self.size, 4 * self.size)
        corners = transform(affine, np.array([[left, top], [right, top], [right, bottom], [left, bottom]]))
        photo = np.zeros((self.size, self.size), np.uint8)
        cv2.fillConvexPoly(photo, np.rint(corners * 16).astype(np.int32), 1, shift=4)
        return crop * photo[..., None]


def truncated_normal(rng: np.random.Generator, sigma: float) -> float:
    """Normal noise without the tails beyond two sigma (the paper's box noise)."""
    while abs(value := rng.normal(0, 1)) > 2:
        pass
    return sigma * value
