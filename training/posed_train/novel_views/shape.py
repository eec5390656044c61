"""An object's shape, carved out of voxels by the masks of its photos (visual hull: Laurentini, PAMI 1994)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ..bop import DatasetError, View
from ..rays import origin
from ..registration import locate, project

VOXELS = 112
"""Along the longest side."""
ROOM = 1.3
"""The grid's side by the object's extent."""
SHARE = 0.92
"""Of the photos that show where a voxel is, so many have it in their masks: no mask is without fault."""
LEAST_PHOTOS = 8
"""That must show where a voxel is."""
SMOOTH_VOXELS = 1.2
STRIDE = 2
"""Voxels from one look along a ray to the next; what a ray met is then found by halving."""
HALVINGS = 5


@dataclass(frozen=True)
class Shape:
    """How full each voxel is, 0 to 1, smoothed, and where they are in the component's frame, metres."""

    full: np.ndarray  # [N, N, N]
    gradient: np.ndarray  # [3, N, N, N]
    first: np.ndarray  # [3] the middle of the first one
    pitch: float
    middle: np.ndarray  # [3]
    radius: float  # of a sphere about the middle that holds it

    def at(self, volume: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Of points `[P, 3]`."""
        return ndimage.map_coordinates(volume, (points - self.first).T / self.pitch, order=1, mode="constant")

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Outwards, `[P, 3]`."""
        slope = -np.stack([self.at(axis, points) for axis in self.gradient], axis=1)
        return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9)


def carve(views: Sequence[View], masks: Sequence[np.ndarray], camera_from_component: np.ndarray) -> Shape:
    """The shape that nearly all masks agree to."""
    centre, extent = locate(list(views), camera_from_component)
    side = ROOM * float(np.percentile(extent, 90))
    pitch = side / VOXELS
    first = centre - side / 2 + pitch / 2
    axis = np.arange(VOXELS) * pitch
    points = first + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    votes, shown = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
    for view, mask, pose in zip(views, masks, camera_from_component):
        pixels = np.round(project(view.camera_matrix, pose, points)).astype(int)
        height, width = mask.shape
        inside = ((pixels >= 0) & (pixels < [width, height])).all(1)
        shown += inside
        votes[inside] += mask[pixels[inside, 1], pixels[inside, 0]] > 127
    held = (votes >= SHARE * shown) & (shown >= LEAST_PHOTOS)
    full = ndimage.gaussian_filter(held.reshape((VOXELS,) * 3).astype(np.float32), SMOOTH_VOXELS)
    inside = first + pitch * np.argwhere(full > 0.5)
    if not len(inside):
        raise DatasetError("the masks agree on no shape; look at them with `posed-train check`")
    middle = inside.mean(0)
    radius = float(np.linalg.norm(inside - middle, axis=1).max()) + 2 * pitch
    return Shape(full, np.stack(np.gradient(full)), first, pitch, middle, radius)


def surface(shape: Shape, camera_matrix: np.ndarray, pose: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel of a square image first meets the shape: points `[P, 3]` in the component's frame, and which
    pixels `[size, size]` meet it."""
    grid = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).reshape(-1, 2)
    rays = np.column_stack([grid, np.ones(len(grid))]) @ np.linalg.inv(camera_matrix).T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays = rays @ pose[:3, :3]
    eye = origin(pose)
    along = rays @ (shape.middle - eye)
    beside = np.linalg.norm(eye + along[:, None] * rays - shape.middle, axis=1)
    waiting = np.flatnonzero(beside < shape.radius)
    start = along - np.sqrt(np.maximum(shape.radius**2 - beside**2, 0))
    depth = np.full(len(grid), np.nan)
    for step in np.arange(0, 2 * shape.radius, STRIDE * shape.pitch):
        if not len(waiting):
            break
        reached = start[waiting] + step
        met = shape.at(shape.full, eye + reached[:, None] * rays[waiting]) > 0.5
        depth[waiting[met]] = reached[met]
        waiting = waiting[~met & (reached < start[waiting] + 2 * shape.radius)]
    hit = np.isfinite(depth)
    near, far = depth[hit] - STRIDE * shape.pitch, depth[hit]
    for _ in range(HALVINGS):
        middle = (near + far) / 2
        met = shape.at(shape.full, eye + middle[:, None] * rays[hit]) > 0.5
        near, far = np.where(met, near, middle), np.where(met, middle, far)
    return eye + far[:, None] * rays[hit], hit.reshape(size, size)
