"""Training-time variation of a patch: geometry (box noise, in-plane rotation), background, occluders, light, camera."""

from dataclasses import replace

import cv2
import numpy as np

from .crops import CROP_SCALE, ZOOM, Patch, Square, axis_in_image, transform, upright

ZOOM_SHARE = 0.6
"""Of the crops: cut as for the second look."""
# Standard deviations of a crop's size and place, of the box's side: as detectors err, and as a first look does. The
# less, the better: a net is most exact where it has seen most.
BOX_NOISE = 0.08, 0.05
ZOOM_NOISE = 0.04, 0.03
TURN_NOISE = 0.1
"""Of the up axis' image in a first look, over its length when seen from the side: end on, it may point anywhere."""
CAMOUFLAGE_SHARE = 0.5
"""Of the pasted backgrounds: in the object's own colours."""
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
    training lets the net settle on images like those it will see.
    """

    def __init__(
        self, backgrounds: list[np.ndarray], rng: np.random.Generator, size: int, heights: np.ndarray | None = None
    ):
        self.backgrounds, self.rng, self.size, self.heights = backgrounds, rng, size, heights
        self.strength = 1.0

    def __call__(self, patch: Patch) -> tuple[np.ndarray, np.ndarray]:
        """A crop `[S, S, 3]` uint8 and its map `crop_from_patch [2, 3]` of pixels."""
        whole = patch
        if self.backgrounds and patch.mask is not None and self.rng.random() < HALF_HIDDEN_SHARE:
            patch = self.half_hide(patch) if self.rng.random() < 0.5 else self.cut_off(patch)
        crop_from_patch = self.random_affine(patch, half_hidden=patch is not whole)
        crop = self.warp(patch.rgb, crop_from_patch)
        if patch.mask is not None and self.backgrounds:
            mask = self.warp(patch.mask, crop_from_patch).astype(np.float32)[..., None] / 255
            if self.rng.random() < 0.5 * self.strength:
                own = crop[mask[..., 0] > 0.5]
                hard = len(own) > 0 and self.rng.random() < CAMOUFLAGE_SHARE
                background = camouflage(own, crop.shape[:2], self.rng) if hard else self.random_background()
                crop = crop * mask + background * (1 - mask)
        if self.backgrounds and self.rng.random() < 0.35 * self.strength:
            crop = self.occlude(crop)
        crop = self.vary_camera(self.vary_light(crop.astype(np.float32)))
        crop = np.clip(crop, 0, 255).astype(np.uint8)
        return self.blacken_beyond(patch.border, crop, crop_from_patch), crop_from_patch

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

    def random_background(self) -> np.ndarray:
        image = self.backgrounds[self.rng.integers(len(self.backgrounds))]
        side = int(self.rng.integers(self.size, min(image.shape[:2]) + 1))
        top = self.rng.integers(image.shape[0] - side + 1)
        left = self.rng.integers(image.shape[1] - side + 1)
        cut = cv2.resize(image[top : top + side, left : left + side], (self.size, self.size))
        return cut[:, ::-1] if self.rng.random() < 0.5 else cut

    def blacken_beyond(
        self, border: tuple[float, float, float, float], crop: np.ndarray, affine: np.ndarray
    ) -> np.ndarray:
        """What lies outside the photo is black, whatever its light and background."""
        left, top, right, bottom = np.clip(border, -4 * self.size, 4 * self.size)
        corners = transform(affine, np.array([[left, top], [right, top], [right, bottom], [left, bottom]]))
        photo = np.zeros((self.size, self.size), np.uint8)
        cv2.fillConvexPoly(photo, np.rint(corners * 16).astype(np.int32), 1, shift=4)
        return crop * photo[..., None]

    def cut_off(self, patch: Patch) -> Patch:
        """Moves one side of the photo's border across the object."""
        pixels = np.argwhere(patch.mask > 127)[:, ::-1]
        if not len(pixels):
            return patch
        border, side = list(patch.border), self.rng.integers(4)
        hidden = self.rng.uniform(0.1, 0.6)
        border[side] = np.quantile(pixels[:, side % 2], hidden if side < 2 else 1 - hidden).round() + 0.5
        left, top, right, bottom = np.clip(np.ceil(border), 0, len(patch.mask)).astype(int)
        mask = np.zeros_like(patch.mask)
        mask[top:bottom, left:right] = patch.mask[top:bottom, left:right]
        return self.with_less(patch, mask, border=tuple(border))

    def half_hide(self, patch: Patch) -> Patch:
        """Puts a foreign plate before one side of the object. Its box shrinks, as it does where real things hide it."""
        rng, size = self.rng, len(patch.mask)
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
        rgb = patch.rgb * (1 - weight) + cv2.resize(self.random_background(), (size, size)) * weight
        return self.with_less(patch, cv2.min(patch.mask, 255 - plate), rgb=rgb.astype(np.uint8))

    def with_less(self, patch: Patch, mask: np.ndarray, **changes) -> Patch:
        """The patch of which only so much is to be seen, its box with it; as it was where that is too little."""
        box = cv2.boundingRect(mask)
        if min(box[2:]) < 0.3 * max(box[2:]):  # a sliver, or nothing
            return patch
        return replace(patch, mask=mask, box=Square.around(box, 1.0), **changes)

    def occlude(self, crop: np.ndarray) -> np.ndarray:
        """Covers a convex blob somewhere over the object with foreign texture."""
        rng = self.rng
        centre = rng.normal(self.size / 2, self.size / 4.5, 2)
        points = centre + rng.normal(0, self.size * rng.uniform(0.05, 0.16), (6, 2))
        blob = np.zeros((self.size, self.size), np.float32)
        cv2.fillConvexPoly(blob, cv2.convexHull(points.astype(np.int32)), 1.0, cv2.LINE_AA)
        return crop * (1 - blob[..., None]) + self.random_background() * blob[..., None]

    def vary_light(self, crop: np.ndarray) -> np.ndarray:
        rng, s = self.rng, self.strength
        crop = 255 * (np.clip(crop, 0, 255) / 255) ** np.exp(rng.normal(0, 0.25 * s))
        grey = crop.mean(axis=2, keepdims=True)
        crop = grey + (crop - grey) * rng.uniform(1 - 0.4 * s, 1 + 0.3 * s)
        mean = crop.mean()
        crop = mean + (crop - mean) * rng.uniform(1 - 0.35 * s, 1 + 0.35 * s)
        tint = rng.uniform(1 - 0.12 * s, 1 + 0.12 * s, 3).astype(np.float32)
        return crop * rng.uniform(1 - 0.35 * s, 1 + 0.35 * s) * tint + rng.normal(0, 8 * s)

    def vary_camera(self, crop: np.ndarray) -> np.ndarray:
        rng, s = self.rng, self.strength
        if rng.random() < 0.4 * s:
            crop = cv2.GaussianBlur(crop, (0, 0), rng.uniform(0.3, 1.6))
        if rng.random() < 0.35 * s:  # cameras sharpen: without this, photos seemed larger than renders by three percent
            crop = crop + rng.uniform(0.3, 2.5) * (crop - cv2.GaussianBlur(crop, (0, 0), rng.uniform(0.5, 1.5)))
        if rng.random() < 0.5 * s:
            crop = crop + rng.uniform(1, 10) * rng.standard_normal(crop.shape, np.float32)
        return crop


def camouflage(own: np.ndarray, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Stripes or checks `[*shape, 3]` of a colour of the object, whose pixels are `own` `[P, 3]`, and another colour,
    often one of its own, too."""
    first, second = own[rng.integers(len(own), size=2)] + rng.normal(0, 12, (2, 3))
    if rng.random() < 0.6:
        second = rng.uniform(0, 255, 3)
    turn, period = rng.uniform(-np.pi, np.pi), rng.uniform(4, 40)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) / period
    cells = np.floor(np.moveaxis(np.indices(shape), 0, -1) @ axes.T + rng.uniform(0, 2, 2))
    both = cells.sum(-1) if rng.random() < 0.6 else cells[..., 0]
    mix = cv2.GaussianBlur(both % 2, (0, 0), 0.6)[..., None]
    return first + (second - first) * mix


def truncated_normal(rng: np.random.Generator, sigma: float) -> float:
    """Normal noise without the tails beyond two sigma (the paper's box noise)."""
    while abs(value := rng.normal(0, 1)) > 2:
        pass
    return sigma * value
