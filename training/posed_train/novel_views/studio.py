"""An object's photos and its shape: what other cameras would see of it.

With a shape, a photo's pixels have a place in space, and a new camera sees them there; where a photo shows nothing, its
neighbours are asked (image-based rendering: Buehler et al., SIGGRAPH 2001).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from ..bop import DatasetError, View, read_mask, read_rgb
from ..crops import Square
from ..rays import origin
from ..registration import project
from .relight import relight
from .shape import carve, surface

DEPTH_PX = 160
"""Side of a photo's depth map."""
MOST_TURN_DEG = 22.0
DISTANCES = 0.55, 1.35
"""Of the photo's."""
NEIGHBOURS = 5
SHARP_DEG = 6.0
"""A photo from so much farther aside says far less of a pixel."""
HIDDEN_VOXELS = 3.0
"""A photo shows what lies no farther than so much behind the first thing on its ray."""
LEAST_KNOWN = 0.8
"""Share of a new view that some photo must show."""
CHUNK = 30000  # pixels that OpenCV looks up at a time


@dataclass(frozen=True)
class Photo:
    """One that lends its pixels."""

    rgb: np.ndarray  # [H, W, 3] uint8
    mask: np.ndarray  # [H, W] uint8
    camera_matrix: np.ndarray
    camera_from_component: np.ndarray
    depth: np.ndarray  # [S, S] of the shape, infinite where there is none
    depth_matrix: np.ndarray  # the camera's, for the pixels of `depth`
    towards: np.ndarray  # unit direction from the object to the camera

    def shows(self, points: np.ndarray, normals: np.ndarray, slack_m: float) -> tuple[np.ndarray, np.ndarray]:
        """The colours `[P, 3]` of points, and how well it shows them `[P]`, 0 to 1."""
        pixels = project(self.camera_matrix, self.camera_from_component, points).astype(np.float32)
        colours, inside = look_up(self.rgb, pixels).astype(float), look_up(self.mask, pixels) > 200
        depths = points @ self.camera_from_component[2, :3] + self.camera_from_component[2, 3]
        at = np.round(project(self.depth_matrix, self.camera_from_component, points)).astype(int).clip(0, DEPTH_PX - 1)
        free = depths < self.depth[at[:, 1], at[:, 0]] + slack_m
        rays = origin(self.camera_from_component) - points
        facing = np.clip((rays * normals).sum(1) / np.linalg.norm(rays, axis=1), 0, 1)
        return colours, inside * free * facing**2


@dataclass(frozen=True)
class NewView:
    rgb: np.ndarray  # [S, S, 3] uint8, black where the object is not
    mask: np.ndarray  # [S, S] uint8
    camera_matrix: np.ndarray
    camera_from_component: np.ndarray
    box: tuple[float, float, float, float]


class Studio:
    """An object's photos and its shape. `camera_from_component` `[V, 4, 4]` are the photos' relative poses."""

    def __init__(self, views: Sequence[View], camera_from_component: np.ndarray):
        masks = [read_mask(view) for view in views]
        if any(mask is None for mask in masks):
            raise DatasetError("new views need a mask for each photo")
        self.shape = carve(views, masks, camera_from_component)
        self.photos = [self.photo(*one) for one in zip(views, masks, camera_from_component)]
        self.towards = np.stack([photo.towards for photo in self.photos])

    def photo(self, view: View, mask: np.ndarray, pose: np.ndarray) -> Photo:
        matrix = self.matrix_about(view.camera_matrix, pose, DEPTH_PX, 1.0)
        points, hit = surface(self.shape, matrix, pose, DEPTH_PX)
        depth = np.full(hit.shape, np.inf, np.float32)
        depth[hit] = points @ pose[2, :3] + pose[2, 3]
        return Photo(read_rgb(view.image_path), mask, view.camera_matrix, pose, depth, matrix, self.direction(pose))

    def direction(self, camera_from_component: np.ndarray) -> np.ndarray:
        towards = origin(camera_from_component) - self.shape.middle
        return towards / np.linalg.norm(towards)

    def matrix_about(self, camera_matrix: np.ndarray, pose: np.ndarray, size: int, room: float) -> np.ndarray:
        """That of a square image about the object, whose side is `room` times what the object may need."""
        middle = project(camera_matrix, pose, self.shape.middle[None])[0]
        depth = float(self.shape.middle @ pose[2, :3] + pose[2, 3])
        side = 2 * room * self.shape.radius * camera_matrix[0, 0] / depth
        return Square(*(middle + 0.5 - side / 2), side).crop_from_image(size) @ camera_matrix

    def beside(self, photo: Photo, rng: np.random.Generator) -> np.ndarray:
        """`camera_from_component` of a camera that sees the object in the same direction of its own, but was carried
        about the object and along its ray."""
        axis = rng.normal(size=3)
        turn = Rotation.from_rotvec(np.radians(rng.uniform(0, MOST_TURN_DEG)) * axis / np.linalg.norm(axis)).as_matrix()
        pose = photo.camera_from_component
        middle = pose[:3, :3] @ self.shape.middle + pose[:3, 3]
        moved = np.eye(4)
        moved[:3, :3] = pose[:3, :3] @ turn
        moved[:3, 3] = middle * np.exp(rng.uniform(*np.log(DISTANCES))) - moved[:3, :3] @ self.shape.middle
        return moved

    def render(
        self, pose: np.ndarray, camera_matrix: np.ndarray, size: int, room: float, rng: np.random.Generator | None
    ) -> NewView | None:
        """What a camera sees, in another light if there are random numbers; `None` where the photos show too little of
        it."""
        matrix = self.matrix_about(camera_matrix, pose, size, room)
        points, hit = surface(self.shape, matrix, pose, size)
        if not len(points):
            return None
        normals = self.shape.normals(points)
        apart_deg = np.degrees(np.arccos(np.clip(self.towards @ self.direction(pose), -1, 1)))
        colours, weights = np.zeros((len(points), 3)), np.full(len(points), 1e-9)
        for number in np.argsort(apart_deg)[:NEIGHBOURS]:
            seen, weight = self.photos[number].shows(points, normals, HIDDEN_VOXELS * self.shape.pitch)
            weight = weight * np.exp(-((apart_deg[number] / SHARP_DEG) ** 2) / 2 - apart_deg[number] / 10)
            colours += weight[:, None] * seen
            weights += weight
        unknown = weights < 1e-6
        if unknown.mean() > 1 - LEAST_KNOWN:
            return None
        colours /= weights[:, None]
        if rng is not None:
            colours *= relight(points, normals, origin(pose), rng)
        rgb, mask, holes = (
            np.zeros((size, size, 3), np.uint8),
            np.zeros((size, size), np.uint8),
            np.zeros_like(hit, np.uint8),
        )
        rgb[hit], mask[hit], holes[hit] = np.clip(colours, 0, 255), 255, 255 * unknown
        rgb = cv2.inpaint(rgb, holes, 3, cv2.INPAINT_TELEA)
        box = tuple(float(value) for value in cv2.boundingRect(mask))
        return NewView(rgb, cv2.GaussianBlur(mask, (0, 0), 0.7), matrix, pose, box)


def look_up(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Bilinear, `[P, ...]`; 0 outside."""
    chunks = [pixels[at : at + CHUNK][None] for at in range(0, len(pixels), CHUNK)]
    return np.concatenate([cv2.remap(image, part[..., 0], part[..., 1], cv2.INTER_LINEAR)[0] for part in chunks])
