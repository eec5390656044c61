"""Where the virtual keypoints sit, per connected component of views.

Within a component every relative camera pose is known, so all cameras share one frame and ONE transform
`component_from_keypoints` serves every view. Its rotation is arbitrary; its translation is the least-squares
triangulation of the box centres. The keypoints' projections are then the training targets, with no pose label
and no model of the object.
"""

from dataclasses import dataclass

import numpy as np

from .bop import View

# A keypoint should rarely fall outside its crop (1.5 x the larger box side), also where the object looks small.
RADIUS_PERCENTILE = 20
SIZE_PERCENTILE = 95


@dataclass(frozen=True)
class Registration:
    keypoints: np.ndarray  # [N, 3] metres, in the frame `keypoints`
    camera_from_keypoints: np.ndarray  # [V, 4, 4], one for each view
    size_m: float  # the object's extent as the boxes show it


def camera_from_component(views: list[View]) -> np.ndarray:
    """`[V, 4, 4]`, with the first view's camera as the component's frame.

    This is the only use of the object poses: the relative pose of two views, in which the object frame cancels.
    """
    object_from_first = np.linalg.inv(views[0].camera_from_object)
    return np.stack([view.camera_from_object @ object_from_first for view in views])


def rays(views: list[View]) -> np.ndarray:
    """Unit directions `[V, 3]` through the box centres, in each camera's frame."""
    centres = np.array([[v.box[0] + (v.box[2] - 1) / 2, v.box[1] + (v.box[3] - 1) / 2, 1.0] for v in views])
    inverse = np.stack([np.linalg.inv(v.camera_matrix) for v in views])
    directions = np.einsum("vij,vj->vi", inverse, centres)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def triangulate_centre(views: list[View], camera_from_component: np.ndarray, iterations: int = 10) -> np.ndarray:
    """The point nearest to all rays through the box centres (weighted by 1/distance: boxes cut by occluders err)."""
    rotation = camera_from_component[:, :3, :3]
    origins = -np.einsum("vji,vj->vi", rotation, camera_from_component[:, :3, 3])
    directions = np.einsum("vji,vj->vi", rotation, rays(views))
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    weights = np.ones(len(views))
    for _ in range(iterations):
        weighted = across * weights[:, None, None]
        point = np.linalg.solve(weighted.sum(0), np.einsum("vij,vj->i", weighted, origins))
        distance = np.linalg.norm(np.einsum("vij,vj->vi", across, point - origins), axis=1)
        weights = 1 / np.maximum(distance, np.median(distance))
    return point


def cube(radius: float) -> np.ndarray:
    """The eight vertices of a cube on a sphere of this radius: well spread, and no four neighbours collinear."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    return signs * radius / np.sqrt(3)


def random_rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def register(views: list[View], seed: int) -> Registration:
    """Chooses the virtual keypoints of an object and places them in every view of one component."""
    from_component = camera_from_component(views)
    centre = triangulate_centre(views, from_component)
    depth = np.einsum("vj,j->v", from_component[:, 2, :3], centre) + from_component[:, 2, 3]
    focal = np.array([v.camera_matrix[0, 0] for v in views])
    extent = np.array([max(v.box[2:]) for v in views]) * depth / focal
    component_from_keypoints = np.eye(4)
    component_from_keypoints[:3, :3] = random_rotation(seed)
    component_from_keypoints[:3, 3] = centre
    return Registration(
        keypoints=cube(np.percentile(extent, RADIUS_PERCENTILE) / 2),
        camera_from_keypoints=from_component @ component_from_keypoints,
        size_m=float(np.percentile(extent, SIZE_PERCENTILE)),
    )


def project(camera_matrix: np.ndarray, camera_from_points: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels `[..., N, 2]` of points `[N, 3]` under poses `[..., 4, 4]`."""
    in_camera = points @ np.swapaxes(camera_from_points[..., :3, :3], -1, -2) + camera_from_points[..., None, :3, 3]
    pixels = in_camera @ np.swapaxes(camera_matrix, -1, -2)
    return pixels[..., :2] / pixels[..., 2:]
