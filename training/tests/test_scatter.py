"""What held-out photos tell of covariances."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posed_train.pnp import Solved, stepped
from posed_train.scatter import along_ray, log_factors, squared_errors

PARTS = ("depth", "lateral", "rotation")


def drawn(count, factors, seed=0):
    """True poses, and solved ones whose errors are so many times what their covariances say."""
    rng = np.random.default_rng(seed)
    pairs = []
    for _ in range(count):
        truth = np.eye(4)
        truth[:3, :3] = Rotation.random(random_state=rng).as_matrix()
        truth[:3, 3] = rng.uniform((-0.3, -0.3, 0.4), (0.3, 0.3, 1.0))
        root = np.diag([0.002, 0.002, 0.002, 0.03, 0.03, 0.03]) @ rng.normal(0, 1, (6, 6))
        stated = Solved(truth, root @ root.T + 1e-7 * np.eye(6), 8)
        step = np.linalg.cholesky(widened(stated, factors).covariance) @ rng.normal(0, 1, 6)
        pairs.append((truth, Solved(stepped(truth, step), stated.covariance, 8)))
    return pairs


def widened(found, factors):
    """As the service does by such factors (`scaled_covariance` in `src/estimator/evidence.rs`)."""
    depth, lateral, rotation = factors
    along = along_ray(found.camera_from_keypoints)
    matrix = along.T @ np.diag([depth, lateral, lateral, rotation, rotation, rotation]) @ along
    return Solved(found.camera_from_keypoints, matrix @ found.covariance @ matrix.T, found.inliers)


@pytest.mark.parametrize("factors", [(1.0, 1.0, 1.0), (3.0, 1.0, 2.0), (1.0, 2.5, 1.0), (1.5, 1.5, 4.0)])
def test_factors_are_found_again(factors):
    found = log_factors(drawn(2000, factors))
    np.testing.assert_allclose([np.exp(found[part]) for part in PARTS], factors, rtol=0.08)


def test_a_few_photos_cannot_promise_more_than_the_solver():
    found = log_factors(drawn(12, (0.2, 0.2, 0.2)))
    assert found == {"depth": 0.0, "lateral": 0.0, "rotation": 0.0}


def test_wrong_poses_do_not_widen_what_the_others_say():
    pairs = drawn(200, (2.0, 2.0, 2.0))
    wrong = [(truth, Solved(stepped(truth, np.full(6, 3.0)), one.covariance, 8)) for truth, one in pairs[:40]]
    found = log_factors(wrong + pairs[40:])
    assert all(np.exp(found[part]) < 3.2 for part in PARTS)


def test_widened_covariances_hold():
    pairs = drawn(1000, (3.0, 1.0, 2.0), seed=1)
    factors = [np.exp(log_factors(pairs)[part]) for part in PARTS]
    rows = [squared_errors(truth, widened(one, factors)) for truth, one in pairs]
    for part, degrees in zip(PARTS, (1, 2, 3)):
        assert np.mean([row[part] for row in rows]) == pytest.approx(degrees, rel=0.15)


def test_poses_that_are_mostly_wrong_do_not_make_covariances_endless():
    pairs = [(truth, Solved(stepped(truth, np.full(6, 1.0)), 1e-8 * np.eye(6), 8)) for truth, _ in drawn(20, (1, 1, 1))]
    assert all(np.exp(value) < 12 for value in log_factors(pairs).values())
