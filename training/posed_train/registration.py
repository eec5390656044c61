"""Where the virtual keypoints sit, per connected component of views.

Views whose relative camera poses are known form a component: all its cameras share one frame, so ONE transform
`component_from_keypoints` serves them all. For the first component its rotation is arbitrary and its translation the
least-squares triangulation of the box centres; the keypoints' projections are then the training targets, with no pose
label and no model of the object. Further components cannot be placed by geometry, since the frame of the keypoints is
fixed by now: a net trained on the first one votes (`join`).
"""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from .bop import DatasetError, View
from .keypoints import virtual_keypoints

SOURCES = ("object", "camera")
"""Where relative poses come from: `object`, two poses of one still object; `camera`, the camera poses of a scene."""
# A keypoint should rarely fall outside its crop (1.5 x the larger box side), also where the object looks small.
RADIUS_PERCENTILE = 20
SIZE_PERCENTILE = 95
JOIN_ROTATION_DEG = 10.0
JOIN_DISTANCE_OF_SIZE = 0.15
JOIN_RATIO = 0.6


@dataclass
class Component:
    """Views that share a frame, and where the keypoints lie in it, once that is known."""

    views: list[int]  # indices
    camera_from_component: np.ndarray  # [V, 4, 4]
    component_from_keypoints: np.ndarray | None = None


@dataclass
class Registration:
    keypoints: np.ndarray  # [N, 3] metres, in the frame `keypoints`
    components: list[Component]
    size_m: float  # the object's extent as the boxes show it
    placed: dict[int, np.ndarray] = field(default_factory=dict)
    """`camera_from_keypoints` of each view whose component is placed, by the view's index."""

    def place(self, component: Component, component_from_keypoints: np.ndarray) -> None:
        component.component_from_keypoints = component_from_keypoints
        for index, camera_from_component in zip(component.views, component.camera_from_component):
            self.placed[index] = camera_from_component @ component_from_keypoints


def find_components(views: list[View], source: str) -> list[Component]:
    """The components of a dataset, the largest first; views in a stable order within each."""
    if source == "camera":
        scenes: dict[str, list[int]] = {}
        for index, view in enumerate(views):
            if view.camera_from_world is None:
                raise DatasetError(
                    f"{view.image_path}: scene_camera.json has no cam_R_w2c and cam_t_w2c for this image; with "
                    'poses = "camera" every image needs its camera\'s pose in the scene'
                )
            scenes.setdefault(f"{view.split}/{view.scene}", []).append(index)
        for group in scenes.values():
            path, times = Counter(views[index].image_path for index in group).most_common(1)[0]
            if times > 1:
                raise DatasetError(
                    f'{path}: shows the object more than once; with poses = "camera" a scene may hold it once, for '
                    "nothing tells its copies apart"
                )
        groups = list(scenes.values())
        poses = [np.stack([views[i].camera_from_world for i in group]) for group in groups]
    elif source == "object":
        # The only use of object poses: the relative pose of two views, in which the object's frame cancels.
        for view in views:
            if view.camera_from_object is None:
                raise DatasetError(
                    f"{view.image_path}: scene_gt.json has no cam_R_m2c and cam_t_m2c for this object; with "
                    'poses = "object" they give the relative poses of the views'
                )
        groups = [list(range(len(views)))]
        object_from_first = np.linalg.inv(views[0].camera_from_object)
        poses = [np.stack([view.camera_from_object @ object_from_first for view in views])]
    else:
        raise ValueError(f"poses {source!r}: choose one of {', '.join(SOURCES)}")
    components = [Component(group, pose) for group, pose in zip(groups, poses)]
    return sorted(components, key=lambda component: -len(component.views))


def rays(views: list[View]) -> np.ndarray:
    """Unit directions `[V, 3]` through the box centres, in each camera's frame."""
    centres = np.array([[v.box[0] + (v.box[2] - 1) / 2, v.box[1] + (v.box[3] - 1) / 2, 1.0] for v in views])
    inverse = np.stack([np.linalg.inv(v.camera_matrix) for v in views])
    directions = np.einsum("vij,vj->vi", inverse, centres)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def rays_in_component(views: list[View], camera_from_component: np.ndarray) -> np.ndarray:
    """Unit directions `[V, 3]` through the box centres, in the component's frame."""
    return np.einsum("vji,vj->vi", camera_from_component[:, :3, :3], rays(views))


def triangulate_centre(views: list[View], camera_from_component: np.ndarray, iterations: int = 10) -> np.ndarray:
    """The point nearest to all rays through the box centres (weighted by 1/distance: boxes cut by occluders err)."""
    origins = -np.einsum("vji,vj->vi", camera_from_component[:, :3, :3], camera_from_component[:, :3, 3])
    directions = rays_in_component(views, camera_from_component)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    weights = np.ones(len(views))
    for _ in range(iterations):
        weighted = across * weights[:, None, None]
        point = np.linalg.solve(weighted.sum(0), np.einsum("vij,vj->i", weighted, origins))
        distance = np.linalg.norm(np.einsum("vij,vj->vi", across, point - origins), axis=1)
        weights = 1 / np.maximum(distance, np.median(distance))
    return point


def random_rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def extents(views: list[View], camera_from_component: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """How large the object is in each view's box, metres."""
    depth = np.einsum("vj,j->v", camera_from_component[:, 2, :3], centre) + camera_from_component[:, 2, 3]
    focal = np.array([v.camera_matrix[0, 0] for v in views])
    return np.array([max(v.box[2:]) for v in views]) * depth / focal


def locate(views: list[View], camera_from_component: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The object's centre `[3]` in the component and how large it is in each view's box `[V]`, metres."""
    centre = triangulate_centre(views, camera_from_component)
    extent = extents(views, camera_from_component, centre)
    if not np.isfinite(extent).all() or extent.min() <= 0:
        raise DatasetError(
            f"{views[0].image_path.parent.parent}: the rays through the box centres do not meet in front of the "
            "cameras; check that camera poses map the scene to the camera (w2c, not c2w), and that boxes are of one "
            "object"
        )
    return centre, extent


def register(views: list[View], source: str, seed: int, shape: str = "cube", count: int = 8) -> Registration:
    """Chooses the virtual keypoints of an object and places them in every view of the largest component."""
    components = find_components(views, source)
    first = components[0]
    chosen = [views[i] for i in first.views]
    if len(chosen) < 2:
        raise DatasetError("no two images share a component; learning needs pairs with known relative camera poses")
    centre, extent = locate(chosen, first.camera_from_component)
    radius = float(np.percentile(extent, RADIUS_PERCENTILE) / 2)
    placement = np.eye(4)
    placement[:3, :3] = random_rotation(seed)
    placement[:3, 3] = centre
    registration = Registration(
        keypoints=virtual_keypoints(shape, radius, count, seed),
        components=components,
        size_m=float(np.percentile(extent, SIZE_PERCENTILE)),
    )
    registration.place(first, placement)
    return registration


def consensus(votes: np.ndarray, rotation_deg: float, distance_m: float) -> np.ndarray:
    """The mean `[4, 4]` of the poses that agree with one of them (paper, algorithm 1, with every vote as a
    hypothesis)."""
    agreeing = agree(votes, votes, rotation_deg, distance_m)
    return mean_pose(votes[agreeing[agreeing.sum(1).argmax()]])


def angles_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`[A, B]` degrees between the rotations of poses `[A, 4, 4]` and `[B, 4, 4]`."""
    cosines = (np.einsum("aij,bij->ab", a[:, :3, :3], b[:, :3, :3]) - 1) / 2
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def agree(a: np.ndarray, b: np.ndarray, rotation_deg: float, distance_m: float) -> np.ndarray:
    """`[A, B]`: which poses are that close to each other."""
    distances = np.linalg.norm(a[:, None, :3, 3] - b[None, :, :3, 3], axis=-1)
    return (angles_deg(a, b) < rotation_deg) & (distances < distance_m)


def mean_pose(poses: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Chordal mean of the rotations, arithmetic mean of the translations."""
    mean = np.eye(4)
    u, _, vt = np.linalg.svd(np.average(poses[:, :3, :3], axis=0, weights=weights))
    mean[:3, :3] = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    mean[:3, 3] = np.average(poses[:, :3, 3], axis=0, weights=weights)
    return mean


def join(registration: Registration, camera_from_keypoints: dict[int, np.ndarray | None]) -> int:
    """Places further components by the poses that a net trained so far finds in their views; returns how many joined.

    Every view votes for `component_from_keypoints`; a component joins when enough votes agree.
    """
    joined = 0
    for component in registration.components:
        if component.component_from_keypoints is not None:
            continue
        votes = [
            np.linalg.inv(from_component) @ camera_from_keypoints[index]
            for index, from_component in zip(component.views, component.camera_from_component)
            if camera_from_keypoints.get(index) is not None
        ]
        if len(votes) < 2:
            continue
        thresholds = JOIN_ROTATION_DEG, JOIN_DISTANCE_OF_SIZE * registration.size_m
        mean = consensus(np.stack(votes), *thresholds)
        agreeing = agree(np.stack(votes), mean[None], *thresholds).sum()
        if agreeing >= 2 and agreeing / len(component.views) >= JOIN_RATIO:
            registration.place(component, mean)
            joined += 1
    return joined


def project(camera_matrix: np.ndarray, camera_from_points: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels `[..., N, 2]` of points `[N, 3]` under poses `[..., 4, 4]`."""
    in_camera = points @ np.swapaxes(camera_from_points[..., :3, :3], -1, -2) + camera_from_points[..., None, :3, 3]
    pixels = in_camera @ np.swapaxes(camera_matrix, -1, -2)
    return pixels[..., :2] / pixels[..., 2:]
