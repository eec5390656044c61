"""Where rays begin and meet, and where up is."""

import numpy as np


def origin(camera_from_world: np.ndarray) -> np.ndarray:
    """Where the camera is, `[3]`."""
    return -camera_from_world[:3, :3].T @ camera_from_world[:3, 3]


def nearest_point(origins: np.ndarray, directions: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """The point `[3]` nearest to rays `[V, 3]` of unit direction, by least squares. Where many are as near, as with
    parallel rays, the one nearest to the frame's origin."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    if weights is not None:
        across = across * weights[:, None, None]
    return np.linalg.lstsq(across.sum(0), np.einsum("vij,vj->i", across, origins), rcond=None)[0]


LEAST_TURNED = 0.02
"""Share of what the second axis explains: photos that all look one way do not tell which way they are tilted."""


def upwards(camera_from_world: np.ndarray) -> np.ndarray:
    """The direction `[3]` that photos have upwards, by their poses `[V, 4, 4]`; all zeros where they do not tell.

    Their right is level where cameras are held level, however much they look down: up is square to that in most photos.
    """
    mean = -camera_from_world[:, 1, :3].mean(0)
    right, weights = camera_from_world[:, 0, :3], np.ones(len(camera_from_world))
    up = mean
    for _ in range(10):
        spread, axes = np.linalg.eigh(np.einsum("v,vi,vj->ij", weights, right, right))
        if spread[1] < LEAST_TURNED * spread.sum():
            up = mean
            break
        up = axes[:, 0] * (1 if axes[:, 0] @ mean > 0 else -1)
        weights = 1 / np.maximum(np.abs(right @ up), 0.1)
    length = np.linalg.norm(up)
    return up / length if length > 1e-6 and np.linalg.norm(mean) > 1e-6 else np.zeros(3)
