"""How far an object's poses scatter, against what they say of themselves: covariances that hold, from a dozen held-out
photos. `posed-train trust` says more, and needs hundreds of views with exact poses."""

from collections.abc import Sequence

import numpy as np

from .data import Views
from .pnp import Solved, solve, step_between
from .spread import nearest
from .validate import Predictor, predict_views

LEAST_VIEWS = 8
"""Fewer tell nothing."""
ANY_TURN = 12
"""So many turns after which an object looks the same stand for any about an axis: how far it is turned about that is
unknown to within half a step, which says nothing of the net."""
MOST_LOG_FACTOR = 2.3
"""Tenfold: where most poses are that far off, they are wrong, and no covariance helps."""
MEDIAN_OF_CHI_SQUARED = {"depth": 0.455, "lateral": 1.386, "rotation": 2.366}
"""Of a pose's error by parts, with one, two and three degrees of freedom."""


def covariance_trust(net: Predictor, views: Views, scale: np.ndarray) -> dict | None:
    """`trust` of `object.json`, of covariances alone; `None` where too few views are held out, or where the net chooses
    the keypoints' frame. `scale` multiplies the net's covariances, one factor a keypoint.

    Views of components that joined later are placed by what a net said of them: they would agree with its errors.
    """
    first = set(views.registration.components[0].views)
    indices = [index for index in views.held_out if index in first]
    if views.heights is None or len(indices) < LEAST_VIEWS:
        return None
    keypoints = views.registration.keypoints
    predictions = predict_views(net, [views.all[index] for index in indices])
    solved = [solve(keypoints, prediction, scale) for prediction in predictions]
    placed = np.stack([views.registration.placed[index] for index in indices])[:, None]
    pairs = [
        (nearest(pose, one.camera_from_keypoints, views.motions)[0], one)
        for pose, one in zip(placed, solved)
        if one is not None
    ]
    if len(pairs) < LEAST_VIEWS:
        return None
    logs = log_factors(pairs)
    if len(views.motions) >= ANY_TURN:
        logs["rotation"] = 0.0
    return {"ranges": {}, "covariance": {part: {"constant": round(value, 3)} for part, value in logs.items()}}


def log_factors(pairs: Sequence[tuple[np.ndarray, Solved]]) -> dict[str, float]:
    """Of true poses and solved ones: logarithms of what the solved ones' standard deviations are to be multiplied by.
    By the median, which wrong poses hardly move; never below 1, for so few views cannot promise more than the solver.
    """
    rows = [squared_errors(truth, one) for truth, one in pairs]
    medians = {part: np.median([row[part] for row in rows]) for part in MEDIAN_OF_CHI_SQUARED}
    logs = {part: 0.5 * float(np.log(medians[part] / MEDIAN_OF_CHI_SQUARED[part])) for part in medians}
    return {part: min(max(0.0, value), MOST_LOG_FACTOR) for part, value in logs.items()}


def squared_errors(truth: np.ndarray, found: Solved) -> dict[str, float]:
    """A pose's error squared, in units of its covariance: along the ray to it, across, and of the rotation."""
    along = along_ray(truth)
    step, covariance = along @ step_between(truth, found.camera_from_keypoints), along @ found.covariance @ along.T
    parts = {"depth": slice(0, 1), "lateral": slice(1, 3), "rotation": slice(3, 6)}
    return {part: float(step[at] @ np.linalg.solve(covariance[at, at], step[at])) for part, at in parts.items()}


def along_ray(pose: np.ndarray) -> np.ndarray:
    """`[6, 6]`: turns steps so that their first axis is the ray to a pose. Rotations keep the camera's axes."""
    ray = pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    axes = np.linalg.qr(np.column_stack([ray, np.eye(3)]))[0]
    turn = np.eye(6)
    turn[:3, :3] = axes.T
    return turn
