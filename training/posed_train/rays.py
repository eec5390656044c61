"""Where rays meet."""

import numpy as np


def nearest_point(origins: np.ndarray, directions: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """The point `[3]` nearest to rays `[V, 3]` of unit direction, by least squares. Where many are as near, as with
    parallel rays, the one nearest to the frame's origin."""
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    if weights is not None:
        across = across * weights[:, None, None]
    return np.linalg.lstsq(across.sum(0), np.einsum("vij,vj->i", across, origins), rcond=None)[0]
