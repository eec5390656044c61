"""An object's shape as voxels, by the votes of its masks in many photos."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from .grabcut import Window, overlap
from .solid import Frame, Solid

VOXELS = 80
"""Along the longest side."""
ROOM = 1.25
"""The grid's size by the solid's."""
MUCH_ROOM = 1.5
"""By its longest side along all axes, where that was too little: three boxes may fit a solid half as wide as the
object."""
COARSE_VOXELS = 40
THRESHOLDS = (0.6, 0.7, 0.8, 0.85, 0.9, 0.95)
MIN_VOTES = 3


@dataclass(frozen=True)
class Hull:
    points: np.ndarray  # [N, 3] metres, middles of its voxels
    pitch: float

    def project(self, frame: Frame, window: Window) -> np.ndarray:
        """As a mask of a window."""
        width, height = window.size
        mask = np.zeros((height, width), np.uint8)
        if not len(self.points):
            return mask
        pixels = np.round(window.to_window(frame.project(self.points))).astype(int)
        inside = ((pixels >= 0) & (pixels < [width, height])).all(1)
        mask[pixels[inside, 1], pixels[inside, 0]] = 255
        depth = max(frame.depth(self.points.mean(0)), 1e-3)
        gap = int(np.ceil(1.6 * self.pitch * frame.matrix[0, 0] * window.scale / depth)) | 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap + 2, gap + 2))
        return cv2.morphologyEx(mask, cv2.MORPH_CLOSE, kernel)


def around(hull: Hull, solid: Solid) -> Solid:
    """The smallest upright box of the hull, standing where the solid stands."""
    (x, y), (length, width), turn = cv2.minAreaRect(hull.points[:, :2].astype(np.float32))
    top = float(hull.points[:, 2].max()) + hull.pitch / 2
    size = np.maximum([length, width, top - solid.base[2]], hull.pitch)
    return replace(solid, base=np.array([x, y, solid.base[2]]), yaw=np.radians(turn), size=size).with_long_side_first()


def grid(solid: Solid, sides: np.ndarray, pitch: float) -> np.ndarray:
    """Points `[N, 3]` in a box of that size around a solid."""
    axes = [np.arange(-side / 2, side / 2 + pitch, pitch) for side in sides]
    local = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    pose = solid.standing_from_box
    points = local @ pose[:3, :3].T + pose[:3, 3]
    return points[points[:, 2] >= solid.base[2]].astype(np.float32)


def rooms(solid: Solid, carve_points: Callable[[np.ndarray], np.ndarray]) -> Iterator[tuple[Hull, np.ndarray]]:
    """What the drawn boxes leave room for: first near the solid, which is the better prior, then all of it. With the
    size of the grid."""
    longest = float(solid.size.max())
    pitch, sides = ROOM * longest / VOXELS, ROOM * solid.size
    yield Hull(carve_points(grid(solid, sides, pitch)), pitch), sides
    coarse, sides = MUCH_ROOM * longest / COARSE_VOXELS, np.full(3, MUCH_ROOM * longest)
    rough = carve_points(grid(solid, sides, coarse))
    if len(rough):
        sides = 2 * (np.abs(from_middle(rough, solid)).max(0) + coarse)
        pitch = float(sides.max()) / VOXELS
        yield Hull(carve_points(grid(solid, sides, pitch)), pitch), sides


def larger(solid: Solid, hull: Hull) -> Solid:
    """The solid, or the box of a hull if that is larger: what a photo's window must hold."""
    found = around(hull, solid) if len(hull.points) else solid
    return found if np.prod(found.size) > np.prod(ROOM * solid.size) else solid


def from_middle(points: np.ndarray, solid: Solid) -> np.ndarray:
    """In the frame of the solid's box."""
    pose = solid.standing_from_box
    return (points - pose[:3, 3]) @ pose[:3, :3]


def is_cramped(hull: Hull, solid: Solid, sides: np.ndarray) -> bool:
    """Whether a hull ends where its grid does, which was too small then."""
    return bool((from_middle(hull.points, solid).max(0) > sides / 2 - hull.pitch).any()) or bool(
        (from_middle(hull.points, solid).min(0)[:2] < -sides[:2] / 2 + hull.pitch).any()
    )


def carve(points: np.ndarray, drawn: Sequence[tuple[Frame, np.ndarray]], slack: float, slack_px: float) -> np.ndarray:
    """The points `[N, 3]` that lie in all drawn boxes, each widened a little."""
    keep = np.ones(len(points), bool)
    for frame, box in drawn:
        room = slack * (box[2:] - box[:2]).max() + slack_px
        limits = np.array([0, 0, frame.width - 1, frame.height - 1])
        low, high = box[:2] - room, box[2:] + room
        low = np.where(box[:2] <= limits[:2] + 1, -np.inf, low)
        high = np.where(box[2:] >= limits[2:] - 1, np.inf, high)
        pixels = frame.project(points)
        keep &= ((pixels >= low) & (pixels <= high)).all(1)
    return points[keep]


def vote(points: np.ndarray, seen: Sequence[tuple[Frame, Window, np.ndarray]]) -> np.ndarray:
    """Share of the masks `[N]` that each point lies in, of the photos that show where it is."""
    votes, voters = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
    for frame, window, mask in seen:
        pixels = frame.project(points)
        shown = ((pixels >= 0) & (pixels <= [frame.width - 1, frame.height - 1])).all(1)
        place = np.round(window.to_window(pixels[shown])).astype(int)
        width, height = window.size
        within = ((place >= 0) & (place < [width, height])).all(1)
        hit = np.zeros(len(place), bool)
        hit[within] = mask[place[within, 1], place[within, 0]] > 0
        votes[shown] += hit
        voters += shown
    return np.where(voters >= MIN_VOTES, votes / np.maximum(voters, 1), 0)


def consensus(points: np.ndarray, pitch: float, seen: Sequence[tuple[Frame, Window, np.ndarray]]) -> Hull:
    """The shape that agrees best with the masks, of all that a share of them agrees to."""
    shares = vote(points, seen)
    best, best_score = Hull(points[:0], pitch), -1.0
    for threshold in THRESHOLDS:
        hull = Hull(points[shares >= threshold], pitch)
        if len(hull.points) < 8:
            break
        score = float(np.median([overlap(hull.project(frame, window), mask) for frame, window, mask in seen]))
        if score > best_score:
            best, best_score = hull, score
    return best
