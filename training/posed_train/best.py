"""The best net of a training, by the views held out from it.

The last net need not be the best: towards the end the crops vary less, and what the net then learns of them may be
wrong of others. Nothing else tells, for the loss falls on.
"""

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from torch import nn

from .data import Views
from .metrics import rotation_error_deg, translation_error_m
from .optimise import load, save
from .validate import Prediction, Predictor, predict_views, solve_pose


@dataclass(frozen=True)
class Standing:
    """What a net does on held-out views, against the poses that they were registered with."""

    views: int
    deg5_cm5_percent: float
    keypoint_median_px: float

    def better_than(self, other: "Standing", gain: float = 0.0) -> bool:
        """By the poses; by the keypoints where the poses differ by no more than the views tell (a standard error).
        These must be better by a share of `gain`."""
        share = other.deg5_cm5_percent / 100
        told_percent = 100 * max(math.sqrt(share * (1 - share) / other.views), 1 / other.views)
        more = self.deg5_cm5_percent - other.deg5_cm5_percent
        return more > told_percent or (
            more >= -told_percent and self.keypoint_median_px < (1 - gain) * other.keypoint_median_px
        )


def standing(net: Predictor, views: Views) -> Standing | None:
    """`None` where no views are held out, or where the net chooses the keypoints' frame (`heights` is none)."""
    if not views.held_out or views.heights is None:
        return None
    predictions = predict_views(net, [views.all[index] for index in views.held_out])
    poses = [solve_pose(views.registration.keypoints, prediction) for prediction in predictions]
    return standing_of(views, views.held_out, predictions, poses)


def standing_of(
    views: Views, indices: list[int], predictions: list[Prediction], poses: list[np.ndarray | None]
) -> Standing:
    """By what the net says of placed views."""
    good, pixels = [], []
    for index, prediction, pose, alike in zip(indices, predictions, poses, views.targets(indices)):
        pixels.append(np.median(np.linalg.norm(prediction.keypoints - alike, axis=-1), axis=-1).min())
        expected = views.registration.placed[index] @ views.motions
        good.append(
            pose is not None
            and any(rotation_error_deg(pose, one) < 5 and translation_error_m(pose, one) < 0.05 for one in expected)
        )
    return Standing(len(good), 100 * float(np.mean(good)), float(np.median(pixels)))


class Best:
    """`best.pt`: the best net so far."""

    def __init__(self, path: Path, resumed: bool):
        self.path = path
        self.standing: Standing | None = None
        if resumed and path.exists():
            self.standing = Standing(**load(path, "cpu", ["standing"])["standing"])

    def offer(self, net: nn.Module, step: int, found: Standing | None) -> None:
        if found is not None and (self.standing is None or found.better_than(self.standing)):
            save({"step": step, "average": net.state_dict(), "standing": asdict(found)}, self.path)
            self.standing = found

    def forget(self) -> None:
        """Other views are held out from now on: what was the best among the old ones says nothing."""
        self.standing = None

    def restore(self, net: nn.Module) -> int | None:
        """Gives the net the best weights; returns their step, or `None` where nothing told which are best."""
        if self.standing is None:
            return None
        state = load(self.path, "cpu", ("step", "average"))
        net.load_state_dict(state["average"])
        return state["step"]
