"""Scores a keypoint net on held-out views with ground-truth boxes."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from . import metrics
from .bop import View, read_rgb
from .crops import Square, Variant, crops_around, elsewhere, look_closer
from .registration import project


@dataclass(frozen=True)
class Predictor:
    """A net, wherever it runs. `run` takes crops `[B, S, S, 3]` uint8 and gives keypoints `[B, N, 2]`, covariances
    `[B, N, 2, 2]` in crop pixels, peaks `[B, N]`. `heights` `[N]`, if it was trained to look twice: the keypoints'
    coordinates along the axis that points up then."""

    size: int
    run: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
    heights: np.ndarray | None = None


CROP_ENSEMBLE = (Variant(0.97, -7), Variant(1.03, 7))
"""The crops that keypoints are averaged over."""
MAX_LOOKS = 4
"""From the second one on, a look is followed by another only where its keypoints lie elsewhere than it was cut for."""
MAX_DISAGREEMENT = 0.1
"""Mean distance of two crops' keypoints, of the box's side. One crop of a symmetric object may show other keypoints
than the next, and be as right; their mean is not."""


@dataclass(frozen=True)
class Prediction:
    """What the net says of one view, in image pixels."""

    view: View
    keypoints: np.ndarray  # [N, 2]
    covariances: np.ndarray  # [N, 2, 2]
    peaks: np.ndarray  # [N]


def predict_views(
    predictor: Predictor, views: list[View], ensemble: tuple[Variant, ...] = CROP_ENSEMBLE
) -> list[Prediction]:
    """The mean over each view's crops, as the service takes it."""
    predictions = []
    for view in views:
        image, box = read_rgb(view.image_path), Square.around(view.box, 1.0)
        if predictor.heights is None:
            predictions.append(look(predictor, view, image, box, ensemble))
            continue
        prediction, place = look(predictor, view, image, box, (Variant(),)), box
        for again in range(MAX_LOOKS - 1):
            closer = look_closer(prediction.keypoints, predictor.heights, box)
            if closer is None or (again and not elsewhere(closer, place)):
                break
            prediction, place = look(predictor, view, image, closer, ensemble), closer
        predictions.append(prediction)
    return predictions


def look(predictor: Predictor, view: View, image: np.ndarray, box: Square, ensemble: tuple[Variant, ...]) -> Prediction:
    crops, squares = crops_around(box, image, predictor.size, ensemble)
    keypoints, covariances, peaks = predictor.run(crops)
    in_image = [square.to_image(found, predictor.size) for square, found in zip(squares, keypoints)]
    back = np.stack([np.linalg.inv(square.crop_from_image(predictor.size))[:2, :2] for square in squares])[:, None]
    covariances = back @ covariances @ back.transpose(0, 1, 3, 2)
    agreeing = largest_agreement(np.stack(in_image), MAX_DISAGREEMENT * box.side)
    return Prediction(view, *(np.mean(np.asarray(of)[agreeing], axis=0) for of in (in_image, covariances, peaks)))


def largest_agreement(keypoints: np.ndarray, within: float) -> np.ndarray:
    """Which of the crops' keypoints `[E, N, 2]` lie about where those of some crop do, `[E]`: of the crop with most
    company, the first of them."""
    apart = np.linalg.norm(keypoints[:, None] - keypoints[None], axis=-1).mean(-1)
    near = apart <= within
    return near[near.sum(1).argmax()]


def solve_pose(keypoints: np.ndarray, prediction: Prediction) -> np.ndarray | None:
    """`camera_from_keypoints` by OpenCV: RANSAC over P3P, then least squares on the inliers."""
    camera = prediction.view.camera_matrix
    pixels = np.ascontiguousarray(prediction.keypoints, dtype=float)
    tolerance_px = 0.05 * max(prediction.view.box[2:])
    try:
        found, rvec, tvec, inliers = cv2.solvePnPRansac(
            keypoints, pixels, camera, None, flags=cv2.SOLVEPNP_SQPNP, reprojectionError=tolerance_px
        )
    except cv2.error:  # keypoints all in one place, as those of a net that has just begun to learn
        return None
    if not found or inliers is None:
        return None
    rows = inliers.ravel()
    rvec, tvec = cv2.solvePnPRefineLM(keypoints[rows], pixels[rows], camera, None, rvec, tvec)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rvec)[0], tvec.ravel()
    return pose


def score(
    model: metrics.Model, keypoints: np.ndarray, keypoints_from_object: np.ndarray, predictions: list[Prediction]
) -> dict[str, float]:
    """ADD(-S) < 10 % of the diameter, Proj-5 and 5 deg 5 cm, as percentages, and median errors: of the pose, of the
    keypoints, and of their common scale, from which the depth follows."""
    add, proj, rotation, translation, pixels, scales = [], [], [], [], [], []
    for prediction in predictions:
        alike = prediction.view.camera_from_object @ model.motions
        cameras = np.repeat(prediction.view.camera_matrix[None], len(alike), axis=0)
        expected = project(cameras, alike @ np.linalg.inv(keypoints_from_object), keypoints)
        distances = np.median(np.linalg.norm(prediction.keypoints - expected, axis=-1), axis=-1)
        pixels.append(distances.min())
        scales.append(abs(relative_scale(prediction.keypoints, expected[distances.argmin()]) - 1))
        pose = solve_pose(keypoints, prediction)
        if pose is None:
            add.append(np.inf)
            proj.append(np.inf)
            rotation.append(180.0)
            translation.append(np.inf)
            continue
        estimate = pose @ keypoints_from_object
        truth = min(alike, key=lambda equal: metrics.rotation_error_deg(estimate, equal))
        add.append(metrics.add(model, estimate, truth))
        proj.append(metrics.projection_error_px(model, estimate, truth, prediction.view.camera_matrix))
        rotation.append(metrics.rotation_error_deg(estimate, truth))
        translation.append(metrics.translation_error_m(estimate, truth))
    add, proj, rotation, translation = map(np.array, (add, proj, rotation, translation))
    return {
        "views": len(predictions),
        "add_percent": 100 * float(np.mean(add < 0.1 * model.diameter)),
        "proj5_percent": 100 * float(np.mean(proj < 5)),
        "deg5_cm5_percent": 100 * float(np.mean((rotation < 5) & (translation < 0.05))),
        "rotation_median_deg": float(np.median(rotation)),
        "translation_median_mm": 1000 * float(np.median(translation)),
        "keypoint_median_px": float(np.median(pixels)),
        "scale_median_percent": 100 * float(np.median(scales)),
    }


def relative_scale(found: np.ndarray, expected: np.ndarray) -> float:
    """How much larger the points `[N, 2]` are as a whole than those expected (least squares)."""
    found, expected = found - found.mean(0), expected - expected.mean(0)
    return float((found * expected).sum() / (expected**2).sum())
