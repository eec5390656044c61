"""`reference.json` of an object whose frame is its box: the offset between that frame and the keypoints, averaged over
many photos as `posed calibrate` does. One photo leaves it as uncertain as one pose; their mean is far better known."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..agreement import image_sizes
from ..bop import DatasetError, View, symmetry_motions
from ..pnp import Solved, step_between, stepped
from ..registration import angles_deg
from ..residual import whole
from .judged import Network

PHOTOS = 24
LEAST_PHOTOS = 3
AGREES_DEG, AGREES_M = 10.0, 0.03
STEPS = 50


@dataclass(frozen=True)
class Offset:
    """Of one photo, or of many."""

    object_from_keypoints: np.ndarray  # [4, 4]
    covariance: np.ndarray  # [6, 6]: of a step along and about the object's axes


@dataclass(frozen=True)
class Reference:
    offset: Offset
    views: list[View]
    inliers: list[bool]
    residuals: list[tuple[float, float]]  # degrees and mm from the common offset

    def as_dict(self, name: str, model_sha256: str) -> dict:
        """`reference/NAME.json`."""
        sizes = image_sizes(self.views)
        entries = [
            {
                "image": image_name(name, view),
                "camera": camera(view, size),
                "camera_from_object": stated(view.camera_from_object),
                "box_px": [float(value) for value in view.box],
                "inlier": inlier,
                "residual_deg": degrees,
                "residual_mm": apart,
            }
            for view, size, inlier, (degrees, apart) in zip(self.views, sizes, self.inliers, self.residuals)
        ]
        return {
            "object": name,
            "keypoint_model_sha256": model_sha256,
            "method": "weighted",
            "object_from_keypoints": stated(self.offset.object_from_keypoints),
            "covariance": ((self.offset.covariance + self.offset.covariance.T) / 2).tolist(),
            "references": entries,
        }

    def images(self, name: str) -> dict[str, bytes]:
        return {image_name(name, view): view.image_path.read_bytes() for view in self.views}


def image_name(name: str, view: View) -> str:
    digest = hashlib.sha256(view.image_path.read_bytes()).hexdigest()[:12]
    return f"{name}-{digest}{view.image_path.suffix}"


def camera(view: View, size: Sequence[float]) -> dict:
    matrix = view.camera_matrix
    fx, fy, cx, cy = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    width, height = (int(side) for side in size)
    return {"model": "pinhole", "width": width, "height": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}


def stated(pose: np.ndarray) -> dict:
    """A pose as posed's files have it."""
    quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat(canonical=True)
    return {"rotation_xyzw": quaternion.tolist(), "translation_m": pose[:3, 3].tolist()}


def measure(network: Network, views: Sequence[View]) -> Reference:
    """By photos that show the object whole, from all sides."""
    chosen = choose(views, PHOTOS)
    solved = [(view, one) for view, one in zip(chosen, network.solve(chosen)) if one is not None]
    symmetries = symmetry_motions(network.manifest.get("symmetries_discrete", []))
    return average([view for view, _ in solved], [of_photo(view, one) for view, one in solved], symmetries)


def choose(views: Sequence[View], count: int) -> list[View]:
    """Photos that show the object whole, from directions as different as can be."""
    known = [view for view in views if view.camera_from_object is not None]
    if not known:
        raise DatasetError("no photo states the pose of the object's box: `posed-train label` it by a box")
    shown = [view for view, size in zip(known, image_sizes(known)) if whole(view, size)] or known
    places = np.stack([np.linalg.inv(view.camera_from_object)[:3, 3] for view in shown])
    directions = places / np.linalg.norm(places, axis=1, keepdims=True)
    chosen, nearest = [0], directions @ directions[0]
    while len(chosen) < min(count, len(shown)):
        nearest[chosen] = 2  # more alike than any
        chosen.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, directions @ directions[chosen[-1]])
    return [shown[k] for k in sorted(chosen)]


def of_photo(view: View, solved: Solved) -> Offset:
    object_from_camera = np.linalg.inv(view.camera_from_object)
    turn = np.kron(np.eye(2), object_from_camera[:3, :3])
    return Offset(object_from_camera @ solved.camera_from_keypoints, turn @ solved.covariance @ turn.T)


def average(views: list[View], offsets: list[Offset], symmetries: np.ndarray) -> Reference:
    """The offsets that most photos agree on, each weighted by the inverse of its covariance."""
    if len(offsets) < LEAST_PHOTOS:
        raise DatasetError(f"the network finds the object in {len(offsets)} photos only; train longer")
    best = min(offsets, key=lambda offset: np.trace(offset.covariance[3:, 3:]))
    offsets = [nearest(offset, best, symmetries) for offset in offsets]
    poses = np.stack([offset.object_from_keypoints for offset in offsets])
    apart = np.linalg.norm(poses[:, None, :3, 3] - poses[None, :, :3, 3], axis=-1)
    alike = (angles_deg(poses, poses) < AGREES_DEG) & (apart < AGREES_M)
    inliers = alike[alike.sum(1).argmax()]
    if 2 * inliers.sum() <= len(offsets):
        raise DatasetError(
            f"{inliers.sum()} of {len(offsets)} photos agree on where the object's frame lies; train longer"
        )
    offset = weighted_mean([offset for offset, inlier in zip(offsets, inliers) if inlier])
    common = offset.object_from_keypoints
    degrees = angles_deg(poses, common[None])[:, 0]
    millimetres = 1000 * np.linalg.norm(poses[:, :3, 3] - common[:3, 3], axis=1)
    residuals = [(float(a), float(b)) for a, b in zip(degrees, millimetres)]
    return Reference(offset, views, [bool(one) for one in inliers], residuals)


def nearest(offset: Offset, like: Offset, symmetries: np.ndarray) -> Offset:
    """The same offset, measured on the one of the orientations that look alike which is nearest to another's."""
    alike = symmetries @ offset.object_from_keypoints
    motion = symmetries[angles_deg(alike, like.object_from_keypoints[None])[:, 0].argmin()]
    turn = np.kron(np.eye(2), motion[:3, :3])
    return Offset(motion @ offset.object_from_keypoints, turn @ offset.covariance @ turn.T)


def weighted_mean(offsets: Sequence[Offset]) -> Offset:
    """Gauss-Newton on the sum of squared Mahalanobis distances."""
    weights = np.stack([np.linalg.inv(offset.covariance) for offset in offsets])
    total, pose = np.linalg.inv(weights.sum(0)), offsets[0].object_from_keypoints
    for _ in range(STEPS):
        steps = np.stack([step_between(pose, offset.object_from_keypoints) for offset in offsets])
        step = total @ np.einsum("vij,vj->i", weights, steps)
        pose = stepped(pose, step)
        if np.abs(step).max() < 1e-10:
            break
    steps = np.stack([step_between(pose, offset.object_from_keypoints) for offset in offsets])
    chi2 = float(np.einsum("vi,vij,vj->", steps, weights, steps))
    # Photos that scatter more than they admit make the mean less certain.
    return Offset(pose, total * max(1.0, chi2 / max(1, 6 * (len(offsets) - 1))))
