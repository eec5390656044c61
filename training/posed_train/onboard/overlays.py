"""Photos with poses drawn into them."""

import itertools

import cv2
import numpy as np

from ..bop import read_rgb
from ..registration import project
from .judged import Judged, Judgement
from .project import Item
from .result import offset
from .solid import RIM, box_from_object

SIDE_PX = 320
AROUND = 1.7
"""Side of what is shown, of the box's."""
FOUND, EXPECTED = (255, 60, 40), (60, 230, 80)
AXES = ((255, 77, 77), (61, 220, 96), (77, 163, 255))
EDGE = (0, 0, 0)
QUALITY = 85
FINE = 3  # bits


def picture(found: Judgement, item: Item, one: Judged) -> bytes:
    """A JPEG of the photo about the object: its solid where the net sees it (red, with axes), and where the other
    photos put it (green)."""
    image = read_rgb(one.view.image_path)
    x, y, w, h = one.view.box
    side = AROUND * max(w, h)
    scale = SIDE_PX / side
    left, top = x + (w - 1) / 2 - side / 2, y + (h - 1) / 2 - side / 2
    shown_from_image = np.array([[scale, 0, -scale * left], [0, scale, -scale * top], [0, 0, 1]])
    flags = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    shown = cv2.warpAffine(image, shown_from_image[:2], (SIDE_PX, SIDE_PX), flags=flags, borderValue=(60, 60, 60))
    matrix = shown_from_image @ one.view.camera_matrix
    keypoints_from_object, lines, size = wireframe(found, item)
    for pose, colour in ((one.deviation.expected, EXPECTED), (one.deviation.found, FOUND)):
        if pose is not None:
            draw(shown, matrix, pose, lines, colour)
    if one.deviation.found is not None:
        draw_axes(shown, matrix, one.deviation.found @ keypoints_from_object, size / 2)
    return encoded(shown)


def wireframe(found: Judgement, item: Item) -> tuple[np.ndarray, list[np.ndarray], float]:
    """The object's frame among the keypoints, the edges `[N, 3]` of its solid there, and its size, metres."""
    object_from_keypoints = offset(found.result)
    if object_from_keypoints is None or len(item.size_mm) != 3:
        points = found.network.keypoints
        size = 2 * float(np.abs(points).max())
        return np.eye(4), [np.array(pair) for pair in itertools.combinations(points, 2)], size
    sides = np.array(item.size_mm) / 1000
    keypoints_from_object = np.linalg.inv(object_from_keypoints)
    object_from_box = box_from_object(item.up)[:3, :3].T
    upright = np.abs(object_from_box).T @ sides
    lines = cylinder(upright) if item.solid == "cylinder" else box(upright)
    moved = [
        line @ (keypoints_from_object[:3, :3] @ object_from_box).T + keypoints_from_object[:3, 3] for line in lines
    ]
    return keypoints_from_object, moved, float(sides.max())


def box(sides: np.ndarray) -> list[np.ndarray]:
    """Its twelve edges, about the origin."""
    corners = [np.array(signs) for signs in itertools.product((-0.5, 0.5), repeat=3)]
    pairs = itertools.combinations(corners, 2)
    return [np.stack(pair) * sides for pair in pairs if np.abs(pair[0] - pair[1]).sum() == 1]


def cylinder(sides: np.ndarray) -> list[np.ndarray]:
    """Its rims, and four lines between them."""
    rim = np.stack([np.cos(RIM), np.sin(RIM)], axis=1) / 2
    rims = [np.column_stack([rim, np.full(len(rim), z)]) for z in (-0.5, 0.5)]
    between = [np.stack([rims[0][k], rims[1][k]]) for k in range(0, len(rim), len(rim) // 4)]
    return [line * sides for line in [*(np.vstack([one, one[:1]]) for one in rims), *between]]


def draw(image: np.ndarray, matrix: np.ndarray, pose: np.ndarray, lines: list[np.ndarray], colour) -> None:
    for line in lines:
        stroke(image, project(matrix, pose, line), colour, 1)


def draw_axes(image: np.ndarray, matrix: np.ndarray, camera_from_object: np.ndarray, length: float) -> None:
    for axis, colour in zip(np.eye(3), AXES):
        stroke(image, project(matrix, camera_from_object, np.stack([np.zeros(3), length * axis])), colour, 2)


def stroke(image: np.ndarray, pixels: np.ndarray, colour, width: int) -> None:
    """A line with a dark edge, so that it shows on everything."""
    if not np.isfinite(pixels).all() or np.abs(pixels).max() > 20_000:
        return
    points = np.round(pixels * 2**FINE).astype(np.int32)[None]
    for shade, wide in ((EDGE, width + 2), (colour, width)):
        cv2.polylines(image, points, False, shade, wide, cv2.LINE_AA, FINE)


def encoded(image: np.ndarray) -> bytes:
    done, content = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not done:
        raise OSError("OpenCV cannot write JPEG")
    return content.tobytes()
