"""Which net of a training is kept."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from posed_train import best, data
from posed_train.best import Best, Standing
from posed_train.config import KeypointConfig
from posed_train.validate import Prediction

HALF = Standing(views=48, deg5_cm5_percent=50.0, keypoint_median_px=2.0)


@pytest.mark.parametrize(
    ("percent", "pixels", "better"),
    [(60.0, 3.0, True), (40.0, 1.0, False), (52.0, 1.9, True), (48.0, 1.9, True), (52.0, 2.1, False)],
)
def test_poses_count_first_and_keypoints_where_these_tell_nothing(percent, pixels, better):
    assert Standing(48, percent, pixels).better_than(HALF) == better


def test_the_best_net_stays_when_training_goes_on(tmp_path):
    net, path = torch.nn.Linear(2, 1), tmp_path / "best.pt"
    kept = Best(path, resumed=False)
    assert kept.restore(net) is None
    for step, percent in ((1, 50.0), (2, 90.0), (3, 20.0)):
        torch.nn.init.constant_(net.weight, step)
        kept.offer(net, step, replace(HALF, deg5_cm5_percent=percent))
    again = Best(path, resumed=True)
    again.offer(net, 4, HALF)
    again.offer(net, 5, None)
    assert again.restore(net) == 2 and (net.weight == 2).all()
    # A new training knows nothing of one that left its files.
    fresh = Best(path, resumed=False)
    assert fresh.restore(net) is None


def test_a_net_stands_by_its_poses_on_held_out_views(rendered, monkeypatch):
    settings = KeypointConfig(name="cube", obj_id=1, photoreal="train", held_out_scenes=1, min_visible=0.3)
    views = data.Views(settings, rendered)
    truth = views.targets(views.held_out)[:, 0]

    def predicts(change):
        predictions = [
            Prediction(views.all[index], change(keypoints), np.tile(np.eye(2), (8, 1, 1)), np.ones(8))
            for index, keypoints in zip(views.held_out, truth)
        ]
        monkeypatch.setattr(best, "predict_views", lambda *_: predictions)
        return best.standing(None, views)

    assert predicts(lambda keypoints: keypoints + 0.3) == Standing(len(truth), 100.0, pytest.approx(0.3 * 2**0.5))
    mirrored = predicts(lambda keypoints: keypoints[::-1])
    assert mirrored.deg5_cm5_percent == 0 and mirrored.keypoint_median_px > 5
    views.heights = None
    assert predicts(lambda keypoints: keypoints) is None
