"""One number that nearly every mistake in a dataset makes large: how far each box's middle lies from where the object's
middle is seen, by the box's side. Right data have 0.03 in the median, and 0.08 at worst."""

from dataclasses import dataclass, replace

import numpy as np

from .bop import View
from .rays import nearest_point

USUAL = 0.065
"""The median of right data is below."""
ONE_PHOTO = 0.22
"""A single photo of right data is below."""
AGREES = 0.12
PAIRS = 60
BEHIND = 9.0
"""For photos that have the object behind the camera."""
LEAST_VISIBLE = 0.9
BORDER_PX = 2


@dataclass(frozen=True)
class Sights:
    """An object's boxes in V photos of one still scene."""

    camera_matrix: np.ndarray  # [V, 3, 3]
    camera_from_component: np.ndarray  # [V, 4, 4] metres
    boxes: np.ndarray  # [V, 4] x, y, w, h
    size: np.ndarray  # [V, 2] of the images, pixels

    def __len__(self) -> int:
        return len(self.boxes)

    def __getitem__(self, rows) -> "Sights":
        return Sights(self.camera_matrix[rows], self.camera_from_component[rows], self.boxes[rows], self.size[rows])

    @property
    def middles(self) -> np.ndarray:
        return self.boxes[:, :2] + (self.boxes[:, 2:] - 1) / 2

    @property
    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the cameras are and the unit directions to the boxes' middles, `[V, 3]` each, in the component."""
        turn, shift = self.camera_from_component[:, :3, :3], self.camera_from_component[:, :3, 3]
        local = np.einsum(
            "vij,vj->vi", np.linalg.inv(self.camera_matrix), np.column_stack([self.middles, np.ones(len(self))])
        )
        directions = np.einsum("vji,vj->vi", turn, local)
        origins = -np.einsum("vji,vj->vi", turn, shift)
        return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def with_poses(self, poses: np.ndarray) -> "Sights":
        return replace(self, camera_from_component=poses)


def sights(views: list[View], poses: np.ndarray, sizes: np.ndarray) -> Sights:
    return Sights(np.stack([v.camera_matrix for v in views]), poses, np.array([v.box for v in views], float), sizes)


def whole(view: View, size: tuple[int, int]) -> bool:
    """That its box's middle is the object's: nothing hides a part, or cuts it off."""
    x, y, w, h = view.box
    inside = x >= BORDER_PX and y >= BORDER_PX and x + w <= size[0] - BORDER_PX and y + h <= size[1] - BORDER_PX
    return inside and view.visible_fraction >= LEAST_VISIBLE


def off(seen: Sights, centre: np.ndarray) -> np.ndarray:
    """`[V]`: distance of each box's middle from where the point is seen, by the box's side."""
    in_camera = seen.camera_from_component[:, :3, :3] @ centre + seen.camera_from_component[:, :3, 3]
    depth = in_camera[:, 2]
    pixels = np.einsum("vij,vj->vi", seen.camera_matrix, in_camera)[:, :2] / np.where(depth > 1e-9, depth, 1)[:, None]
    distance = np.linalg.norm(pixels - seen.middles, axis=1) / seen.boxes[:, 2:].max(1)
    return np.where(depth > 1e-9, np.minimum(distance, BEHIND), BEHIND)


def meeting_point(seen: Sights, weights: np.ndarray | None = None) -> np.ndarray:
    """Nearest to all rays, least squares."""
    return nearest_point(*seen.rays, weights)


def middle(seen: Sights) -> tuple[np.ndarray, np.ndarray]:
    """The point that most photos agree on, and how far off each photo is. A third of them may be wrong."""
    rng, best = np.random.default_rng(0), None
    for _ in range(PAIRS if len(seen) > 3 else 1):
        pair = rng.choice(len(seen), min(2, len(seen)), replace=False)
        found = off(seen, meeting_point(seen[pair]))
        score = np.minimum(found, AGREES).sum()
        if best is None or score < best[0]:
            best = score, found
    found = best[1]
    for _ in range(4):
        agreeing = found < max(AGREES, float(np.quantile(found, 0.5)))
        if agreeing.sum() < 2:
            break
        centre = meeting_point(seen[agreeing])
        again = off(seen, centre)
        if np.minimum(again, AGREES).sum() > np.minimum(found, AGREES).sum() + 1e-12:
            break
        found, best = again, (0, again)
    return meeting_point(seen[found <= np.quantile(found, 0.7)]), found


def typical(seen: Sights) -> float:
    """The median of how far off the photos are."""
    return float(np.median(middle(seen)[1]))
