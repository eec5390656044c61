"""A pose with its covariance from a net's keypoints, as the service solves it: weighted by their covariances."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .validate import Prediction, solve_pose

FLOOR_PX = 0.3
"""Standard deviation that no keypoint is below."""
INLIER = 13.8
"""Squared Mahalanobis distance: 99.9 % of two degrees of freedom."""
STEPS = 12
LEAST_INLIERS = 4


@dataclass(frozen=True)
class Solved:
    camera_from_keypoints: np.ndarray  # [4, 4]
    covariance: np.ndarray
    """`[6, 6]`: of a step along (m) and about (rad) the camera's axes."""
    inliers: int


def solve(keypoints: np.ndarray, prediction: Prediction, scale: np.ndarray | float = 1.0) -> Solved | None:
    """`scale` multiplies the net's covariances, one factor a keypoint."""
    pose = solve_pose(keypoints, prediction)
    if pose is None:
        return None
    covariances = prediction.covariances * np.broadcast_to(scale, len(keypoints))[:, None, None]
    roots = np.linalg.inv(np.linalg.cholesky(covariances + FLOOR_PX**2 * np.eye(2)))
    matrix = prediction.view.camera_matrix
    for _ in range(STEPS):
        error, slope = whitened(keypoints, prediction.keypoints, matrix, pose, roots)
        inside = (error**2).sum(-1) < INLIER
        if inside.sum() < LEAST_INLIERS:
            inside = np.ones(len(keypoints), bool)
        rows, values = slope[inside].reshape(-1, 6), error[inside].ravel()
        step = -np.linalg.lstsq(rows, values, rcond=None)[0]
        pose = stepped(pose, step)
        if np.abs(step).max() < 1e-9:
            break
    try:
        covariance = np.linalg.inv(rows.T @ rows)
    except np.linalg.LinAlgError:
        return None
    freedom = max(1, 2 * int(inside.sum()) - 6)
    chi2 = float((values**2).sum())
    # Keypoints that scatter more than they admit make the pose less certain.
    covariance *= chi2 / freedom if chi2 > improbable(freedom) else 1.0
    good = np.isfinite(pose).all() and np.isfinite(covariance).all() and pose[2, 3] > 0
    return Solved(pose, covariance, int(inside.sum())) if good else None


def whitened(
    keypoints: np.ndarray, pixels: np.ndarray, matrix: np.ndarray, pose: np.ndarray, roots: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals `[N, 2]` by their covariances, and how they change with a step of the pose, `[N, 2, 6]`."""
    turned = keypoints @ pose[:3, :3].T
    x, y, z = (turned + pose[:3, 3]).T
    z = np.where(np.abs(z) > 1e-6, z, 1e-6)
    fx, skew, cx, fy, cy = matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[1, 1], matrix[1, 2]
    error = np.column_stack([(fx * x + skew * y) / z + cx, fy * y / z + cy]) - pixels
    zero = np.zeros_like(z)
    by_point = np.stack(
        [
            np.stack([fx / z, skew / z, -(fx * x + skew * y) / z**2], -1),
            np.stack([zero, fy / z, -fy * y / z**2], -1),
        ],
        axis=1,
    )
    slope = np.concatenate([by_point, by_point @ -cross_matrices(turned)], axis=-1)
    return np.einsum("nij,nj->ni", roots, error), roots @ slope


def cross_matrices(points: np.ndarray) -> np.ndarray:
    """`[N, 3, 3]`, whose products with vectors are the cross products."""
    x, y, z = points.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)


def stepped(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Moved by `step[:3]` along the axes of the frame that the pose maps to, and turned by `step[3:]` about them."""
    out = pose.copy()
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(step[3:]).as_matrix() @ pose[:3, :3], pose[:3, 3] + step[:3]
    return out


def step_between(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The step from a pose to another, `[6]`: what `stepped` undoes."""
    return np.concatenate(
        [other[:3, 3] - pose[:3, 3], Rotation.from_matrix(other[:3, :3] @ pose[:3, :3].T).as_rotvec()]
    )


def improbable(freedom: float) -> float:
    """The 99 % point of chi-squared (Wilson and Hilferty)."""
    spread = 2 / (9 * freedom)
    return freedom * (1 - spread + 2.326 * spread**0.5) ** 3
