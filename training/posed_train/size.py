"""How large an object is by its boxes, compared with what a ruler says."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from .bop import DatasetError
from .residual import Sights, middle

PHOTOS = 40
STARTS = 4
TOLERANCE = 0.12
FITS = 0.015
"""A solid whose outlines are that close to the boxes, by their sides, is the object's shape."""
UNSURE = 0.3
"""The tolerance where neither a solid nor masks tell the shape."""
HULL_VOXELS = 64
HULL_SHARE = 0.93
RIM = np.pi * np.arange(24) / 12


def shapes() -> list[np.ndarray]:
    """Points `[N, 3]` whose hull is a box, an ellipsoid, or a cylinder along one of the axes, all of unit size."""
    circle = np.stack([np.cos(RIM), np.sin(RIM)], axis=1) / 2
    found = [np.array(list(itertools.product((-0.5, 0.5), repeat=3)))]
    for axis in range(3):
        ends = [np.insert(circle, axis, end, axis=1) for end in (-0.5, 0.5)]
        found.append(np.concatenate(ends))
    tilts = np.linspace(-np.pi / 2, np.pi / 2, 9)
    found.append(
        np.concatenate([np.column_stack([np.cos(t) * circle, np.full(len(RIM), np.sin(t) / 2)]) for t in tilts])
    )
    return found


def parse_size(text: str) -> tuple[float, float, float]:
    """ "54x54x54", millimetres."""
    try:
        a, b, c = (float(part) for part in text.lower().replace("×", "x").split("x"))
    except ValueError:
        raise DatasetError(f"--size-mm {text!r}: three lengths in mm, as 54x54x120") from None
    if not all(0 < side < 1e5 for side in (a, b, c)):
        raise DatasetError(f"--size-mm {text!r}: lengths must be above 0")
    return a, b, c


def by_outline(seen: Sights, size_mm: Sequence[float]) -> tuple[float, float]:
    """How much larger the object is in the data than something of this size, and how well it fits, by the boxes' sides:
    a box, cylinder or ellipsoid is turned and scaled so that its outlines have the data's boxes."""
    seen = seen[:: max(1, -(-len(seen) // PHOTOS))]
    centre, _ = middle(seen)
    sides = np.array(size_mm) / 1000
    starts = [np.concatenate([turn, np.zeros(3), [first_scale(seen, centre, sides)]]) for turn in turns(seen)]
    best = None
    for shape in shapes():
        off = edges_off(seen, centre, shape * sides)
        for start in sorted(starts, key=lambda start: np.abs(off(start)).mean())[:STARTS]:
            found = least_squares(off, start, loss="soft_l1", f_scale=0.05, max_nfev=60)
            if best is None or found.cost < best.cost:
                best = found
    return float(np.exp(best.x[6])), float(np.abs(best.fun).mean())


def edges_off(seen: Sights, centre: np.ndarray, points: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Of a turn, a shift and the logarithm of a scale."""
    low, high = seen.boxes[:, :2], seen.boxes[:, :2] + seen.boxes[:, 2:] - 1
    side_px, reach = seen.boxes[:, 2:].max(1), np.ptp(points, axis=0).max()

    def off(p: np.ndarray) -> np.ndarray:
        moved = np.exp(p[6]) * points @ Rotation.from_rotvec(p[:3]).as_matrix().T + centre + p[3:6] * reach
        in_camera = np.einsum("vij,cj->vci", seen.camera_from_component[:, :3, :3], moved)
        in_camera += seen.camera_from_component[:, None, :3, 3]
        pixels = np.einsum("vij,vcj->vci", seen.camera_matrix, in_camera)[..., :2] / np.maximum(
            in_camera[..., 2:], 1e-6
        )
        edges = np.concatenate([pixels.min(1) - low, pixels.max(1) - high], axis=1) / side_px[:, None]
        return np.clip(edges, -5, 5).ravel()

    return off


def by_hull(seen: Sights, masks: Sequence[np.ndarray], size_mm: Sequence[float], up: np.ndarray) -> float:
    """The same by the visual hull of masks `[H, W]`, one a photo: for what is neither box nor cylinder. It stands on a
    board through the origin, which ends the hull where no photo looks from below.

    A hull is larger than what made it, by a tenth and more where no photo is taken from low down. So it is compared
    with the hulls that solids of this size would have in the same photos, lying each way; the one most alike counts.
    """
    some = np.linspace(0, len(seen) - 1, min(len(seen), PHOTOS)).astype(int)
    seen, masks = seen[some], [masks[k] for k in some]
    grid = Grid.around(seen, up, [mask.shape for mask in masks])
    measured = grid.hull(masks)
    if measured is None:
        return float("nan")
    ratios = []
    for solid, sides in itertools.product(shapes(), itertools.permutations(np.array(size_mm) / 1000)):
        if sides[0] < sides[1]:
            continue
        standing = (solid + np.array([0, 0, 0.5])) * sides
        points = grid.on_board(standing, measured)
        expected = grid.hull([outline(seen, k, points, mask.shape) for k, mask in enumerate(masks)])
        if expected is not None:
            ratios.append(np.log(measured.lengths / expected.lengths))
    return float(np.exp(min(ratios, key=np.std)[:3].mean())) if ratios else float("nan")


@dataclass(frozen=True)
class Hull:
    """On a board, in metres."""

    lengths: np.ndarray
    """Length, width, height, and the cube root of the volume."""
    middle: np.ndarray
    yaw: float
    """Of the length."""


@dataclass(frozen=True)
class Grid:
    """Points around an object, upright; `upright` turns them to the photos' frame."""

    upright: np.ndarray
    centre: np.ndarray
    local: np.ndarray
    step: float
    pixels: list[np.ndarray]
    """Of each photo, where in its mask the points are; the number of its pixels for those outside."""

    @classmethod
    def around(cls, seen: Sights, up: np.ndarray, shapes: Sequence[tuple[int, int]]) -> "Grid":
        centre, _ = middle(seen)
        depth = seen.camera_from_component[:, 2, :3] @ centre + seen.camera_from_component[:, 2, 3]
        reach = float(np.percentile(seen.boxes[:, 2:].max(1) * depth / seen.camera_matrix[:, 0, 0], 90))
        axis, upright = np.linspace(-0.7, 0.7, HULL_VOXELS) * reach, frame_with(up)
        local = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        points = local @ upright.T + centre
        above = points @ up >= 0
        local, points, pixels = local[above], points[above], []
        for k, (height, width) in enumerate(shapes):
            x, y = np.round(project(seen, k, points)).astype(int).T
            inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
            pixels.append(np.where(inside, y * width + x, height * width))
        return cls(upright, centre, local, axis[1] - axis[0], pixels)

    def hull(self, masks: Sequence[np.ndarray]) -> Hull | None:
        """Of the points that nearly all masks hold."""
        votes = sum(np.append(mask.ravel() > 0, False)[pixels].astype(int) for mask, pixels in zip(masks, self.pixels))
        held = self.local[votes >= HULL_SHARE * len(masks)]
        if len(held) < 8:
            return None
        place, (length, width), degrees = cv2.minAreaRect(held[:, :2].astype(np.float32))
        if length < width:
            length, width, degrees = width, length, degrees + 90
        sides = np.array([length, width, np.ptp(held[:, 2])]) + self.step
        return Hull(np.append(sides, self.step * np.cbrt(len(held))), np.array(place), np.radians(degrees))

    def on_board(self, points: np.ndarray, like: Hull) -> np.ndarray:
        """Points whose z is the height above the board, turned and moved to where a hull is; in the photos' frame."""
        turned = points @ Rotation.from_euler("z", like.yaw).as_matrix().T
        place = np.append(like.middle, -self.centre @ self.upright[:, 2])
        return (turned + place) @ self.upright.T + self.centre


def project(seen: Sights, k: int, points: np.ndarray) -> np.ndarray:
    """Pixels `[N, 2]` of points `[N, 3]` in photo `k`."""
    in_camera = points @ seen.camera_from_component[k, :3, :3].T + seen.camera_from_component[k, :3, 3]
    return (in_camera @ seen.camera_matrix[k].T)[:, :2] / np.maximum(in_camera[:, 2:], 1e-6)


def outline(seen: Sights, k: int, points: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The mask of a convex solid in photo `k`."""
    pixels = np.clip(project(seen, k, points), -30000, 30000).round().astype(np.int32)
    return cv2.fillConvexPoly(np.zeros(shape, np.uint8), cv2.convexHull(pixels), 1)


def first_scale(seen: Sights, centre: np.ndarray, sides: np.ndarray) -> float:
    depth = seen.camera_from_component[:, 2, :3] @ centre + seen.camera_from_component[:, 2, 3]
    extent = np.median(seen.boxes[:, 2:].max(1) * depth / seen.camera_matrix[:, 0, 0])
    return float(np.log(max(extent, 1e-6) / (1.15 * sides.max())))


def turns(seen: Sights) -> list[np.ndarray]:
    """Ways to lie: each axis up, turned by steps of 30 degrees; up is what the photos have upwards in the mean."""
    up = -seen.camera_from_component[:, 1, :3].mean(0)
    upright = frame_with(up / max(np.linalg.norm(up), 1e-9))
    lying = [
        Rotation.identity(),
        Rotation.from_euler("x", 90, degrees=True),
        Rotation.from_euler("y", 90, degrees=True),
    ]
    return [
        (Rotation.from_matrix(upright) * Rotation.from_euler("z", yaw, degrees=True) * lie).as_rotvec()
        for lie in lying
        for yaw in range(0, 180, 30)
    ]


def frame_with(up: np.ndarray) -> np.ndarray:
    """A rotation whose z is `up`, a unit vector."""
    across = np.cross(up, [1.0, 0, 0] if abs(up[0]) < 0.9 else [0, 1.0, 0])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(up, across), up], axis=1)


def compare_size(
    seen: Sights, size_mm: Sequence[float], masks: Sequence[np.ndarray] = (), up: np.ndarray | None = None
) -> tuple[str, str]:
    """What to print, and what is wrong, if anything. Masks of every photo and the board's `up` serve where the boxes
    alone do not tell the size."""
    ratio, misfit = by_outline(seen, size_mm)
    tolerance = TOLERANCE
    if misfit > FITS:
        by_masks = by_hull(seen, masks, size_mm, up) if len(masks) and up is not None else float("nan")
        if np.isfinite(by_masks):
            ratio = by_masks
        else:
            tolerance = UNSURE
    expected = " x ".join(f"{side:g}" for side in size_mm)
    words = f"size: {100 * ratio:.0f} % of {expected} mm"
    if abs(np.log(ratio)) <= np.log(1 + tolerance):
        return words, ""
    return words, (
        f"the object measures {100 * ratio:.0f} % of {expected} mm: the scale of the camera poses is wrong (multiply "
        f"the translations by {1 / ratio:.2f}): the side of the tags, the length that was measured, or the unit"
    )
