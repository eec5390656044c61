"""What held-out photos tell of covariances."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posed_train.pnp import Solved, stepped
from posed_train.scatter import covariance_trust, log_factors, squared_errors, widened

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
        covariance = widened(stated, trust(factors)).covariance
        step = np.linalg.cholesky(covariance) @ rng.normal(0, 1, 6)
        pairs.append((truth, Solved(stepped(truth, step), stated.covariance, 8)))
    return pairs


def trust(factors):
    return {"covariance": {part: {"constant": np.log(factor)} for part, factor in zip(PARTS, factors)}}


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
    stated = {"covariance": {part: {"constant": value} for part, value in log_factors(pairs).items()}}
    rows = [squared_errors(truth, widened(one, stated)) for truth, one in pairs]
    for part, degrees in zip(PARTS, (1, 2, 3)):
        assert np.mean([row[part] for row in rows]) == pytest.approx(degrees, rel=0.15)


class FewViews:
    heights, held_out = np.zeros(8), list(range(7))


def test_too_few_photos_tell_nothing():
    assert covariance_trust(None, FewViews(), np.ones(8)) is None
