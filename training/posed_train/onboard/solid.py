"""An upright box or elliptic cylinder around an object, fitted to the boxes that a person drew in a few photos."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares

from ..bop import DatasetError
from .project import SOLIDS, Item

RIM = 2 * np.pi * np.arange(32) / 32
OUTLINES = {
    "box": np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]]),
    "cylinder": np.stack([np.cos(RIM), np.sin(RIM)], axis=1),
}
YAW_STARTS = 4
SOFT_PX = 4.0
NEAR_M = 0.02
SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class Frame:
    """One photo of a scene that is to be labelled, in the frame in which things stand: z up."""

    image_id: int
    name: str
    path: Path
    width: int
    height: int
    matrix: np.ndarray  # [3, 3]
    camera_from_standing: np.ndarray  # [4, 4] metres

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels `[N, 2]` of points `[N, 3]`; what lies behind the camera is held just in front of it."""
        seen = points @ self.camera_from_standing[:3, :3].T + self.camera_from_standing[:3, 3]
        depth = np.maximum(seen[:, 2:], NEAR_M)
        return (seen @ self.matrix.T)[:, :2] / depth

    def depth(self, point: np.ndarray) -> float:
        return float(self.camera_from_standing[2, :3] @ point + self.camera_from_standing[2, 3])


@dataclass(frozen=True)
class Solid:
    kind: str  # one of SOLIDS
    base: np.ndarray  # [3] the middle of its base
    yaw: float
    size: np.ndarray  # [3] metres, along its own axes, z up

    @property
    def centre(self) -> np.ndarray:
        return self.base + np.array([0, 0, self.size[2] / 2])

    def standing_from_object(self, item: Item) -> np.ndarray:
        """`[4, 4]`: the object's frame is its box's, its axes named as the item says."""
        return self.standing_from_box @ box_from_object(item.up)

    def describe(self, item: Item) -> None:
        """Tells the item its solid and size."""
        item.solid = self.kind
        along = np.abs(box_from_object(item.up)[:3, :3]).T @ self.size
        item.size_mm = [round(float(1000 * side), 1) for side in along]

    @property
    def standing_from_box(self) -> np.ndarray:
        """`[4, 4]`: the frame of its box, z up, origin in the middle."""
        pose = np.eye(4)
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        pose[:2, :2] = [[cos, -sin], [sin, cos]]
        pose[:3, 3] = self.centre
        return pose

    def points(self) -> np.ndarray:
        """`[N, 3]`, whose convex hull it is."""
        outline = OUTLINES[self.kind] / 2
        local = np.concatenate([np.column_stack([outline, np.full(len(outline), z)]) for z in (-0.5, 0.5)]) * self.size
        pose = self.standing_from_box
        return local @ pose[:3, :3].T + pose[:3, 3]

    def scaled(self, factor: float) -> "Solid":
        """About its middle."""
        lift = self.size[2] * (1 - factor) / 2
        return replace(self, base=self.base + np.array([0, 0, lift]), size=self.size * factor)

    def with_long_side_first(self) -> "Solid":
        """x along the longer horizontal side, yaw within half a turn."""
        solid = self
        if self.size[1] > self.size[0]:
            solid = replace(self, yaw=self.yaw + np.pi / 2, size=self.size[[1, 0, 2]])
        return replace(solid, yaw=float((solid.yaw + np.pi / 2) % np.pi - np.pi / 2))


def box_from_object(up: str) -> np.ndarray:
    """`[4, 4]`: the frame of an object whose axis `up` points up, in that of its box, whose z does. Axes change places
    by turns."""
    places = np.roll(np.eye(3), -"zxy".index(up[-1]), axis=0)
    turn = np.eye(4)
    turn[:3, :3] = (np.diag([1.0, -1, -1]) if up.startswith("-") else np.eye(3)) @ places
    return turn


def silhouette(solid: Solid, frame: Frame) -> np.ndarray:
    """The outline `[N, 2]` in the photo, pixels, not cut at its borders."""
    return cv2.convexHull(frame.project(solid.points()).astype(np.float32))[:, 0]


def fill(outline: np.ndarray, width: int, height: int) -> np.ndarray:
    """A convex outline as a mask of 0 and 255."""
    mask = np.zeros((height, width), np.uint8)
    held = np.clip(outline, -20_000, 20_000) * 2**SUBPIXEL_BITS
    return cv2.fillConvexPoly(mask, np.round(held).astype(np.int32), 255, shift=SUBPIXEL_BITS)


def bounds(solid: Solid, frame: Frame) -> np.ndarray:
    """Left, top, right, bottom, pixels."""
    pixels = frame.project(solid.points())
    return np.concatenate([pixels.min(0), pixels.max(0)])


def fit(
    drawn: Sequence[tuple[Frame, np.ndarray]], kind: str, grounded: bool, start: Solid | None = None
) -> tuple[Solid, float]:
    """The solid whose bounds are the drawn boxes (left, top, right, bottom), and how far off they are (px, mean of
    edges). `grounded`: it stands on z = 0."""
    if kind not in SOLIDS:
        raise DatasetError(f"solid {kind!r}: choose one of {', '.join(SOLIDS)}")
    centre, size = rough_place(drawn) if start is None else (start.centre, float(start.size.mean()))
    if grounded and start is None:
        size = max(size, 1e-3)

    def build(p: np.ndarray) -> Solid:
        sizes = size * np.exp(np.clip(p[3:6], -4, 4))
        bottom = 0.0 if grounded else centre[2] - size / 2 + p[6] * size
        return Solid(kind, np.array([*(centre[:2] + p[:2] * size), bottom]), p[2], sizes)

    def off(p: np.ndarray) -> np.ndarray:
        solid = build(p)
        return np.concatenate([edges_off(bounds(solid, frame), box, frame) for frame, box in drawn])

    best = None
    for yaw in [start.yaw] if start else np.pi / 2 * np.arange(YAW_STARTS) / YAW_STARTS:
        sizes = np.log(start.size / size) if start else np.zeros(3)
        first = [0, 0, yaw, *sizes, *([] if grounded else [0.5 - (start.size[2] / size / 2 if start else 0.5)])]
        found = least_squares(off, first, loss="soft_l1", f_scale=SOFT_PX, max_nfev=200)
        if best is None or found.cost < best.cost:
            best = found
    return build(best.x).with_long_side_first(), float(np.mean(np.abs(off(best.x))))


def edges_off(found: np.ndarray, drawn: np.ndarray, frame: Frame) -> np.ndarray:
    """Pixels between edges `[4]`. Where the photo ends, what lies beyond cannot be seen: there the edge is right."""
    limits = np.array([0, 0, frame.width - 1, frame.height - 1])
    outside = np.array([-1, -1, 1, 1]) * (found - limits) > 0
    touching = np.array([-1, -1, 1, 1]) * (drawn - limits) >= -1
    return np.where(outside & touching, 0, found - drawn)


def rough_place(drawn: Sequence[tuple[Frame, np.ndarray]]) -> tuple[np.ndarray, float]:
    """About where the boxes' middles meet, and how large the thing is there, metres."""
    directions, origins, spans = [], [], []
    for frame, box in drawn:
        middle = np.linalg.solve(frame.matrix, [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2, 1])
        turn = frame.camera_from_standing[:3, :3].T
        directions.append(turn @ middle / np.linalg.norm(middle))
        origins.append(-turn @ frame.camera_from_standing[:3, 3])
    directions, origins = np.stack(directions), np.stack(origins)
    if len(drawn) < 2 or np.abs(directions @ directions.T).min() > np.cos(np.radians(5)):
        raise DatasetError("draw boxes in photos from two sides or more, at least 5 degrees apart; three are better")
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    centre = np.linalg.solve(across.sum(0), np.einsum("vij,vj->i", across, origins))
    for frame, box in drawn:
        spans.append(np.sqrt(np.prod(np.maximum(box[2:] - box[:2], 1))) * frame.depth(centre) / frame.matrix[0, 0])
    if min(spans) <= 0:
        raise DatasetError("the drawn boxes do not meet in front of the cameras: are they of one object?")
    return centre, float(np.median(spans)) / 1.3
