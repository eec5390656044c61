"""The layout of a flat board of unknown print, from the tags that photos show together: a start for `bundle.py`.

Homographies carry each photo's tags into one plane, photo by photo. That plane is then straightened so that all tags
are squares of one size, which makes it metric.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from ..bop import DatasetError
from .tags import MIN_TAGS, Tags

UNIT_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
TOLERANCE_PX = 4.0
MIN_COMMON_TAGS = 2


@dataclass
class Board:
    """Where each tag's corners lie on the board, metres; x right and y down as seen by its reader."""

    corners: dict[int, np.ndarray]  # [4, 2] by tag id

    def seen(self, tags: Tags) -> tuple[np.ndarray, np.ndarray]:
        """What a photo shows of the board: points on it `[N, 2]` and their pixels `[N, 2]`."""
        known = [k for k, tag in enumerate(tags.ids) if tag in self.corners]
        points = [self.corners[tags.ids[k]] for k in known]
        return np.array(points).reshape(-1, 2), tags.corners[known].reshape(-1, 2)


def connected(photos: list[Tags]) -> list[list[int]]:
    """Groups of photos that show common tags, the largest first; photos with too few tags are in none."""
    waiting = [index for index, tags in enumerate(photos) if len(tags) >= MIN_TAGS]
    groups = []
    while waiting:
        group, known = [waiting.pop(0)], set()
        known.update(photos[group[0]].ids.tolist())
        while joining := [k for k in waiting if len(known.intersection(photos[k].ids.tolist())) >= MIN_COMMON_TAGS]:
            group += joining
            waiting = [k for k in waiting if k not in joining]
            for k in joining:
                known.update(photos[k].ids.tolist())
        groups.append(sorted(group))
    return sorted(groups, key=len, reverse=True)


def homography(points: np.ndarray, pixels: np.ndarray) -> np.ndarray | None:
    found, _ = cv2.findHomography(points, pixels, cv2.RANSAC, TOLERANCE_PX)
    return found


def transfer(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    moved = np.column_stack([points.reshape(-1, 2), np.ones(points.size // 2)]) @ matrix.T
    return (moved[:, :2] / moved[:, 2:]).reshape(points.shape)


def chain(photos: list[Tags], group: list[int]) -> dict[int, np.ndarray]:
    """Every tag's corners `[4, 2]` in one plane, up to a homography."""
    first = max(group, key=lambda k: len(photos[k]))
    largest = max(range(len(photos[first])), key=lambda k: cv2.contourArea(photos[first].corners[k].astype(np.float32)))
    start = cv2.getPerspectiveTransform(
        photos[first].corners[largest].astype(np.float32), UNIT_SQUARE.astype(np.float32)
    )
    plane = {tag: [transfer(start, c)] for tag, c in zip(photos[first].ids.tolist(), photos[first].corners)}
    left = [k for k in group if k != first]
    while left:
        k = max(left, key=lambda k: sum(tag in plane for tag in photos[k].ids.tolist()))
        left.remove(k)
        board = Board({tag: np.median(seen, axis=0) for tag, seen in plane.items()})
        to_plane = homography(*board.seen(photos[k])[::-1])
        if to_plane is None:
            continue
        for tag, corners in zip(photos[k].ids.tolist(), photos[k].corners):
            plane.setdefault(tag, []).append(transfer(to_plane, corners))
    return {tag: np.median(seen, axis=0) for tag, seen in plane.items()}


def straighten(plane: dict[int, np.ndarray], side_m: float) -> Board:
    """The plane's homography that makes all tags squares of that side; corners turn clockwise (y down)."""
    tags, corners = list(plane), np.stack(list(plane.values()))
    centre, scale = corners.mean((0, 1)), np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))
    corners = (corners - centre) / scale
    last = np.linalg.norm(corners, axis=-1).max()  # keeps the parameters of one magnitude

    def moved(p: np.ndarray) -> np.ndarray:
        matrix = np.array([[p[0], p[1], 0], [p[2], p[3], 0], [p[4] / last, p[5] / last, 1]])
        return transfer(matrix, corners)

    def unlike_squares(p: np.ndarray) -> np.ndarray:
        quads = moved(p)
        sides = np.roll(quads, -1, axis=1) - quads
        turned = np.stack([-sides[..., 1], sides[..., 0]], axis=-1)
        # Each side is the one before it, turned; and as long as all others.
        return np.concatenate([(np.roll(sides, -1, 1) - turned).ravel(), ((sides**2).sum(-1) - 1).ravel()])

    best = least_squares(unlike_squares, [1, 0, 0, 1, 0, 0], loss="soft_l1", f_scale=0.1)
    squares = moved(best.x)
    right, down = squares[:, 1] - squares[:, 0], squares[:, 3] - squares[:, 0]
    area = right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0]
    if np.median(area) < 0:
        raise DatasetError("the tags' corners turn the wrong way round: the photos are mirrored")
    return Board({tag: square * side_m for tag, square in zip(tags, squares)})


def estimate_board(photos: list[Tags], group: list[int], side_m: float) -> Board:
    """The layout from the photos of one group."""
    return straighten(chain(photos, group), side_m)
