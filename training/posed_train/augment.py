"""Training-time variation of a patch: geometry (box noise, in-plane rotation), background, occluders, light, camera."""

import cv2
import numpy as np

from .crops import CROP_SCALE, Patch

ZOOM_SHARE = 0.6
"""Of the crops: cut as for the second look."""
# Standard deviations of a crop's size and place, of the box's side: as detectors err, and as a first look does. The
# less, the better: a net is most exact where it has seen most.
BOX_NOISE = 0.08, 0.05
ZOOM_NOISE = 0.04, 0.03


class Augmenter:
    """Turns patches into network inputs. `size` is its side; `backgrounds` are RGB images of at
    least this size.

    `strength` scales how often and how much everything varies. It starts at 1; lowering it towards the end of a
    training lets the net settle on images like those it will see.
    """

    def __init__(self, backgrounds: list[np.ndarray], rng: np.random.Generator, size: int):
        self.backgrounds, self.rng, self.size, self.strength = backgrounds, rng, size, 1.0

    def __call__(self, patch: Patch) -> tuple[np.ndarray, np.ndarray]:
        """A crop `[S, S, 3]` uint8 and its map `crop_from_patch [2, 3]` of pixels."""
        crop_from_patch = self.random_affine(patch)
        crop = self.warp(patch.rgb, crop_from_patch)
        if patch.mask is not None and self.backgrounds:
            mask = self.warp(patch.mask, crop_from_patch).astype(np.float32)[..., None] / 255
            if self.rng.random() < 0.5 * self.strength:
                crop = crop * mask + self.random_background() * (1 - mask)
        if self.backgrounds and self.rng.random() < 0.35 * self.strength:
            crop = self.occlude(crop)
        crop = self.vary_camera(self.vary_light(crop.astype(np.float32)))
        return np.clip(crop, 0, 255).astype(np.uint8), crop_from_patch

    def random_affine(self, patch: Patch) -> np.ndarray:
        rng = self.rng
        angle = rng.uniform(-np.pi, np.pi) if rng.random() < 0.15 * self.strength else rng.normal(0, np.radians(25))
        zoom = patch.zoomed is not None and rng.random() < ZOOM_SHARE
        box, (size_noise, place_noise) = (patch.zoomed, ZOOM_NOISE) if zoom else (patch.box, BOX_NOISE)
        crop_side = box.side * CROP_SCALE * np.exp(truncated_normal(rng, size_noise))
        centre = box.centre + box.side * np.array([truncated_normal(rng, place_noise) for _ in range(2)])
        c, s = np.cos(angle) * self.size / crop_side, np.sin(angle) * self.size / crop_side
        linear = np.array([[c, -s], [s, c]])
        return np.column_stack([linear, self.size / 2 - 0.5 - linear @ centre])

    def warp(self, image: np.ndarray, affine: np.ndarray) -> np.ndarray:
        return cv2.warpAffine(image, affine, (self.size, self.size), flags=cv2.INTER_LINEAR)

    def random_background(self) -> np.ndarray:
        image = self.backgrounds[self.rng.integers(len(self.backgrounds))]
        side = int(self.rng.integers(self.size, min(image.shape[:2]) + 1))
        top = self.rng.integers(image.shape[0] - side + 1)
        left = self.rng.integers(image.shape[1] - side + 1)
        cut = cv2.resize(image[top : top + side, left : left + side], (self.size, self.size))
        return cut[:, ::-1] if self.rng.random() < 0.5 else cut

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


def truncated_normal(rng: np.random.Generator, sigma: float) -> float:
    """Normal noise without the tails beyond two sigma (the paper's box noise)."""
    while abs(value := rng.normal(0, 1)) > 2:
        pass
    return sigma * value
