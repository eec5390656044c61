"""How far poses lie from each other where nothing says which is right, and when a training is over."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posed_train import pnp, stopping
from posed_train.bop import View
from posed_train.keypoints import virtual_keypoints
from posed_train.optimise import learning_rate
from posed_train.registration import project
from posed_train.spread import deviations, figures, in_words
from posed_train.train import augmentation_fade
from posed_train.validate import Prediction

IDENTITY = np.eye(4)[None]
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


def pose(rotation_deg, place) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_euler("xyz", rotation_deg, degrees=True).as_matrix(), place
    return out


CAMERAS = [pose((10 * k, 20 * k, 5), (0.1 * k, 0, 0.6)) for k in range(6)]
OBJECT = pose((30, 50, 70), (0.02, 0.01, 0.03))


def test_poses_of_a_still_object_lie_together_wherever_the_cameras_are():
    found = [camera @ OBJECT for camera in CAMERAS]
    found[2] = found[2] @ pose((0, 0, 3), (0, 0, 0))
    found[4] = found[4].copy()
    found[4][:3, 3] += CAMERAS[4][:3, :3] @ [0, 0.02, 0]
    told = deviations(["a"] * 6, CAMERAS, found, IDENTITY)
    # Each is compared with what the others say, which one that is off does not move.
    np.testing.assert_allclose([one.degrees for one in told], [0, 0, 3, 0, 0, 0], atol=0.02)
    np.testing.assert_allclose([one.millimetres for one in told], [0, 0, 0, 0, 20, 0], atol=0.02)
    assert figures(told) == {"photos": 6, "agreeing": 6, "median_degrees": 0.0, "median_mm": 0.0}


def test_a_pose_that_is_missing_or_far_off_is_no_agreement():
    found = [camera @ OBJECT for camera in CAMERAS]
    found[0], found[1] = None, found[1] @ pose((90, 0, 0), (0, 0, 0))
    told = deviations(["a"] * 6, CAMERAS, found, IDENTITY)
    assert [one.agrees for one in told] == [False, False, True, True, True, True]
    np.testing.assert_allclose(told[0].expected, CAMERAS[0] @ OBJECT, atol=1e-9)
    assert told[1].degrees == pytest.approx(90) and told[2].degrees == pytest.approx(0, abs=1e-5)
    words = in_words(figures(told))
    assert words.startswith("4 of 6 held-out photos agree") and "spread 0.0 degrees" in words
    assert "spread" not in in_words(figures(deviations(["a"] * 6, CAMERAS, [None] * 6, IDENTITY)))


def test_each_scene_has_a_frame_of_its_own():
    elsewhere = OBJECT @ pose((0, 90, 0), (0.3, 0, 0))
    found = [camera @ (OBJECT if k < 3 else elsewhere) for k, camera in enumerate(CAMERAS)]
    told = deviations(["a"] * 3 + ["b"] * 3, CAMERAS, found, IDENTITY)
    assert max(one.degrees for one in told) < 1e-4
    alone = deviations(["a", *"bbbbb"], CAMERAS, found, IDENTITY)
    assert not alone[0].compared and not np.isfinite(alone[0].degrees)


def test_an_object_that_looks_the_same_after_a_turn_may_be_seen_turned():
    # Its axis lies beside the middle of the keypoints.
    beside = pose((0, 0, 0), (0.01, 0.02, 0))
    motions = np.stack([np.eye(4), beside @ HALF_TURN @ np.linalg.inv(beside)])
    found = [camera @ OBJECT @ motions[k % 2] for k, camera in enumerate(CAMERAS)]
    told = deviations(["a"] * 6, CAMERAS, found, motions)
    assert max(one.degrees for one in told) < 1e-4 and max(one.millimetres for one in told) < 1e-6
    assert deviations(["a"] * 6, CAMERAS, found, IDENTITY)[1].degrees == pytest.approx(180)


def test_covariances_of_poses_are_true():
    """Their normalised squared errors are as large as they should be, over many noisy views."""
    keypoints = virtual_keypoints("cube", 0.04, 8, 1)
    matrix = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    view = View("", "", 0, Path(), None, matrix, None, None, (240, 160, 160, 160), 1.0)
    rng, squared = np.random.default_rng(5), []
    root = np.array([[1.2, 0.4], [0.0, 0.7]])
    stated = root @ root.T
    for _ in range(1000):
        true = pose(rng.uniform(-180, 180, 3), (0.02, 0.01, 0.4))
        noise = rng.normal(size=(8, 2)) @ np.linalg.cholesky(stated + pnp.FLOOR_PX**2 * np.eye(2)).T
        seen = project(matrix, true, keypoints) + noise
        solved = pnp.solve(keypoints, Prediction(view, seen, np.tile(stated / 2, (8, 1, 1)), np.ones(8)), scale=2.0)
        error = pnp.step_between(solved.camera_from_keypoints, true)
        squared.append(error @ np.linalg.solve(solved.covariance, error))
        np.testing.assert_allclose(pnp.stepped(solved.camera_from_keypoints, error), true, atol=1e-9)
    assert 4.9 < np.median(squared) < 5.8 and 5.3 < np.mean(squared) < 6.7
    outlier = np.zeros((8, 2))
    outlier[3] = 60
    true = pose((20, 30, 40), (0.02, 0.01, 0.4))
    seen = Prediction(view, project(matrix, true, keypoints) + outlier, np.tile(stated, (8, 1, 1)), np.ones(8))
    solved = pnp.solve(keypoints, seen)
    assert solved.inliers == 7 and np.abs(solved.camera_from_keypoints - true).max() < 1e-4
    assert pnp.solve(keypoints, Prediction(view, np.zeros((8, 2)), np.tile(stated, (8, 1, 1)), np.ones(8))) is None


def rows(*standings):
    names = ("step", "held_out_photos", "held_out_deg5_cm5_percent", "held_out_keypoint_px")
    return [dict(zip(names, map(str, one))) for one in standings]


def test_a_training_is_over_when_held_out_photos_gain_no_more():
    rising = rows(*((250 * k, 18, min(90, 10 * k), 10 / k) for k in range(1, 10)))
    assert stopping.last_gain(rising) == 2250
    # A pixel of noise is no gain, and neither is one photo more of eighteen.
    still = rising + rows(*((2250 + 250 * k, 18, 90 + 5 * (k % 2), 1.10) for k in range(1, 9)))
    assert stopping.last_gain(still) == 2250
    assert stopping.cooling(still, 3000, 12000) is None, "patience"
    first, last = stopping.cooling(still, 4000, 12000)
    assert first == 4000 and last == 5000
    assert stopping.cooling(still, 4000, 4800) is None, "the planned end is nearer"
    better = still[:-1] + rows((4250, 18, 90, 1.0))
    assert stopping.cooling(better, 4250, 12000) is None
    # Other photos were held out from there on, or nothing was measured.
    assert stopping.last_gain(still + rows((4500, 24, 50, 3.0))) == 4500
    assert stopping.cooling([{"step": "5000", "loss": "4"}], 5000, 12000) is None


def test_the_rate_falls_from_where_it_is_to_an_early_end():
    planned = [learning_rate(1.0, step, 1000) for step in range(1000)]
    sooner = [learning_rate(1.0, step, 1000, (400, 600)) for step in range(600)]
    assert sooner[:401] == planned[:401] and sooner[-1] < 1e-3
    assert all(0 <= before - later < 0.012 for before, later in pairwise(sooner[300:]))


def test_crops_vary_less_towards_an_early_end():
    fades = [augmentation_fade(step, 1000, 0.4, (300, 500)) for step in (0, 299, 300, 350, 400, 499)]
    assert fades == [1, 1, 1, pytest.approx(0.7), pytest.approx(0.4), pytest.approx(0.4)]
    assert augmentation_fade(450, 1000, 0.4) == 1 and augmentation_fade(800, 1000, 0.4) == pytest.approx(0.4)
