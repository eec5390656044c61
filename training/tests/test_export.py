import numpy as np

from posed_train.export import to_bytes


def test_weights_in_bytes_are_near_and_stay_what_they_are():
    rng = np.random.default_rng(5)
    weights = (rng.normal(size=(64, 32, 3, 3)) * 10 ** rng.uniform(-9, 3, (64, 1, 1, 1))).astype(np.float32)
    weights[7] = 0
    integers, scales = to_bytes(weights)
    stored = integers * scales
    peaks = np.abs(weights).max(axis=(1, 2, 3), keepdims=True)
    assert (np.abs(stored - weights) <= peaks * 0.51 / 127).all()
    again = to_bytes(stored)
    np.testing.assert_array_equal(again[0], integers)
    np.testing.assert_array_equal(again[0] * again[1], stored)
