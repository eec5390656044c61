"""Where a net looks, and how often."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from posed_train.bop import View
from posed_train.validate import CROP_ENSEMBLE, Prediction, Predictor, predict_views, solve_pose

SIZE = 64
KEYPOINTS = np.array([[110.0, 80], [150, 84], [148, 118], [112, 116]])
HEIGHTS = np.array([1.0, 1, -1, -1])


@pytest.fixture
def view(tmp_path: Path) -> View:
    """Its pixels say where they are."""
    across, down = np.meshgrid(np.arange(240), np.arange(200))
    path = tmp_path / "chart.png"
    Image.fromarray(np.stack([across, down, 0 * down], axis=-1).astype(np.uint8)).save(path)
    return View("test", "000000", 0, path, None, np.eye(3), None, None, (95, 62, 70, 75), 1.0)


def beside_by(pixels: float) -> np.ndarray:
    return KEYPOINTS + np.array([pixels, 0])


def larger_by(factor: float) -> np.ndarray:
    return KEYPOINTS.mean(0) + factor * (KEYPOINTS - KEYPOINTS.mean(0))


def seeing(keypoints: list[np.ndarray]) -> tuple[Predictor, list[int]]:
    """A net that sees these keypoints in its runs, the last of them for ever; and the number of crops of each run."""
    runs: list[int] = []

    def run(crops: np.ndarray):
        seen = keypoints[min(len(runs), len(keypoints) - 1)]
        runs.append(len(crops))
        middle, arms = (SIZE - 1) / 2, np.stack(np.meshgrid(*[np.arange(SIZE) - (SIZE - 1) / 2] * 2), -1)
        found = []
        for crop in crops[..., :2].astype(float):
            slopes = np.einsum("yxa,yxc->ca", arms, crop) / (arms[..., 0] ** 2).sum()
            found.append((seen - crop.mean((0, 1))) @ np.linalg.inv(slopes).T + middle)
        count = len(crops), len(KEYPOINTS)
        return np.stack(found), np.broadcast_to(np.eye(2), (*count, 2, 2)), np.ones(count)

    return Predictor(SIZE, run, HEIGHTS), runs


@pytest.mark.parametrize(
    ("seen", "looks"),
    [
        ([beside_by(0)], 2),
        ([beside_by(1), beside_by(0)], 2),
        ([beside_by(8), beside_by(0)], 3),
        ([beside_by(8), beside_by(4), beside_by(0)], 4),
        ([beside_by(8), beside_by(0)] * 3, 4),
        ([larger_by(1.01), larger_by(1)], 2),
        ([larger_by(1.1), larger_by(1)], 3),
    ],
)
def test_looks_follow_keypoints_that_lie_elsewhere(view, seen, looks):
    """Than they were cut for; but not for ever."""
    net, runs = seeing(seen)
    found = predict_views(net, [view])[0].keypoints
    assert runs == [1] + [len(CROP_ENSEMBLE)] * (looks - 1)
    np.testing.assert_allclose(found, seen[min(looks, len(seen)) - 1], atol=0.7)


def test_without_heights_there_is_one_look(view):
    net, runs = seeing([beside_by(8), beside_by(0)])
    predict_views(Predictor(net.size, net.run), [view])
    assert runs == [len(CROP_ENSEMBLE)]


def test_keypoints_in_one_place_have_no_pose(view):
    """As those of a net that has just begun to learn."""
    keypoints = 0.05 * np.array([[x, y, z] for x in (-1.0, 1) for y in (-1, 1) for z in (-1, 1)])
    collapsed = Prediction(view, np.full((8, 2), 100.0), np.tile(np.eye(2), (8, 1, 1)), np.ones(8))
    assert solve_pose(keypoints, collapsed) is None
