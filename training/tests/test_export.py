import json

import numpy as np
import torch

from posed_train import detector
from posed_train.export import export_detector, session, to_bytes


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


def test_the_manifest_states_how_many_boxes_of_a_class_the_graph_returns(tmp_path):
    torch.manual_seed(0)
    export_detector(detector.build(2, "lite0"), ["a", "b"], tmp_path, {})
    manifest = json.loads((tmp_path / "detector.json").read_text())
    # An untrained net sees objects everywhere.
    noise = np.random.default_rng(0).integers(0, 256, (1, detector.HEIGHT, detector.WIDTH, 3), np.uint8)
    (rows,) = session(tmp_path / "detector.onnx").run(["detections"], {"image": noise})
    counts = np.bincount(rows[0, :, 5].astype(int))
    assert counts.max() == manifest["max_detections_per_class"]
