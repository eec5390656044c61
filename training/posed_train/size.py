"""How large an object is by its boxes, compared with what a ruler says."""

import itertools
from collections.abc import Callable, Sequence

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
    board through the origin, which ends the hull where no photo looks from below."""
    some = np.linspace(0, len(seen) - 1, min(len(seen), PHOTOS)).astype(int)
    seen, masks = seen[some], [masks[k] for k in some]
    centre, _ = middle(seen)
    depth = seen.camera_from_component[:, 2, :3] @ centre + seen.camera_from_component[:, 2, 3]
    reach = float(np.percentile(seen.boxes[:, 2:].max(1) * depth / seen.camera_matrix[:, 0, 0], 90))
    upright = frame_with(up)
    axis = np.linspace(-0.7, 0.7, HULL_VOXELS) * reach
    local = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points, votes = local @ upright.T + centre, np.zeros(len(local))
    votes[points @ up < 0] = -np.inf
    for k, mask in enumerate(masks):
        in_camera = points @ seen.camera_from_component[k, :3, :3].T + seen.camera_from_component[k, :3, 3]
        pixels = np.round((in_camera @ seen.camera_matrix[k].T)[:, :2] / np.maximum(in_camera[:, 2:], 1e-6)).astype(int)
        inside = ((pixels >= 0) & (pixels < [mask.shape[1], mask.shape[0]])).all(1)
        votes[inside] += mask[pixels[inside, 1], pixels[inside, 0]] > 0
    hull = local[votes >= HULL_SHARE * len(masks)]
    if len(hull) < 8:
        return float("nan")
    _, (length, width), _ = cv2.minAreaRect(hull[:, :2].astype(np.float32))
    measured = np.sort([length, width, np.ptp(hull[:, 2])]) + axis[1] - axis[0]
    return float(np.exp(np.mean(np.log(measured / np.sort(np.array(size_mm) / 1000)))))


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
