"""Corners of tags as intersections of their sides, which are found along their whole length.

A corner found in its own neighbourhood is drawn inwards by some tenths of a pixel, since three of its four quarters are
white; a straight edge has no such bias, and many more pixels.
"""

import cv2
import numpy as np

ALONG = np.linspace(0.08, 0.92, 24)
"""Where a side is sampled, the corners left out."""
STEP_PX = 0.25
REACH_OF_SIDE = 0.09
"""Less than a cell of any family: beyond it, the tag's own pattern begins."""
REACH_PX = 1.5, 5.0
LEAST_CONTRAST = 12.0
OUTLIER = 2.5


def refine(image: np.ndarray, corners: np.ndarray, rounds: int = 2) -> np.ndarray:
    """Corners `[T, 4, 2]` of a grey image, clockwise; those whose sides are not clear stay where they are."""
    for _ in range(rounds if len(corners) else 0):
        corners = refine_once(image, corners)
    return corners


def refine_once(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    starts, sides = corners, np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(sides, axis=-1, keepdims=True)
    outward = np.stack([sides[..., 1], -sides[..., 0]], axis=-1) / length
    reach = np.clip(REACH_OF_SIDE * length.mean(1), *REACH_PX)  # [T, 1]
    steps = np.linspace(-1, 1, int(2 * REACH_PX[1] / STEP_PX) + 1)
    offsets = reach * steps  # [T, M]
    points = starts[:, :, None] + ALONG[:, None] * sides[:, :, None]  # [T, 4, N, 2]
    places = points[..., None, :] + offsets[:, None, None, :, None] * outward[:, :, None, None]
    flat = places.reshape(-1, places.shape[-2], 2).astype(np.float32)
    profiles = cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    rise = np.diff(profiles.astype(float).reshape(*points.shape[:3], -1), axis=-1)
    middles = (offsets[:, 1:] + offsets[:, :-1])[:, None, None] / 2
    # From black to white outwards; what falls is the next thing beyond the margin.
    weights = np.maximum(rise, 0) ** 2
    total = weights.sum(-1)
    edge = (weights * middles).sum(-1) / np.maximum(total, 1e-9)  # [T, 4, N] px outwards
    clear = (rise.clip(0).sum(-1) > LEAST_CONTRAST) & (np.abs(edge) < 0.8 * reach[:, :, None])
    lines, good = fit(edge, clear)
    return intersections(corners, starts, sides, outward, lines, good, reach)


def fit(edge: np.ndarray, clear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offset and slope `[T, 4, 2]` of each side along itself, and which sides have enough to fit."""
    weights = clear.astype(float)
    for _ in range(3):
        design = np.stack([np.ones_like(ALONG), ALONG - 0.5], axis=-1)
        normal = np.einsum("tsn,ni,nj->tsij", weights, design, design) + 1e-9 * np.eye(2)
        lines = np.linalg.solve(normal, np.einsum("tsn,ni,tsn->tsi", weights, design, edge)[..., None])[..., 0]
        off = np.abs(edge - lines @ design.T)
        usual = np.median(off, axis=-1, keepdims=True)
        weights = clear * (off <= np.maximum(OUTLIER * usual, 0.05))
    return lines, weights.sum(-1) >= len(ALONG) / 2


def intersections(corners, starts, sides, outward, lines, good, reach) -> np.ndarray:
    """Each corner lies on the side before it and on its own."""
    at = starts + 0.5 * sides + lines[..., :1] * outward
    along = sides + lines[..., 1:] * outward
    before_at, before = np.roll(at, 1, axis=1), np.roll(along, 1, axis=1)
    cross = along[..., 0] * before[..., 1] - along[..., 1] * before[..., 0]
    gap = before_at - at
    share = (gap[..., 0] * before[..., 1] - gap[..., 1] * before[..., 0]) / np.where(np.abs(cross) < 1e-9, 1, cross)
    found = at + share[..., None] * along
    usable = good & np.roll(good, 1, axis=1) & (np.linalg.norm(found - corners, axis=-1) < 2 * reach)
    return np.where(usable[..., None], found, corners)
