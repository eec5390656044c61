"""Supervision of heatmaps by the projected virtual keypoints of a registered component."""

import torch
from torch import Tensor
from torch.nn import functional as F

from .heatmap import cell_centres
from .network import HEATMAP_STRIDE, INPUT_SIZE

TARGET_SIGMA_PX = 2.5


def heatmap_loss(logits: Tensor, keypoints: Tensor, distance_weight: float = 0.05) -> Tensor:
    """Cross-entropy against a Gaussian at each keypoint, plus a little soft-argmax distance.

    `logits` is `[B, N, S, S]`, `keypoints` `[B, N, 2]` in crop pixels. Soft-argmax distance alone stays collapsed on
    the crop's centre; cross-entropy leaves that plateau within a few hundred steps. Keypoints outside the crop have
    no target.
    """
    centres = cell_centres(logits.shape[-1]).to(keypoints)
    log_u, log_v = (-0.5 * ((centres - keypoints[..., i, None]) / TARGET_SIGMA_PX) ** 2 for i in (0, 1))
    target = (log_v[..., :, None] + log_u[..., None, :]).flatten(2).softmax(-1)
    log_probability = logits.to(keypoints.dtype).flatten(2).log_softmax(-1)
    entropy = -(target * log_probability).sum(-1)
    probability = log_probability.exp().view(*logits.shape)
    mean = torch.stack([probability.sum(-2) @ centres, probability.sum(-1) @ centres], dim=-1)
    distance = F.smooth_l1_loss(mean, keypoints, reduction="none", beta=HEATMAP_STRIDE).sum(-1)
    inside = ((keypoints > -0.5) & (keypoints < INPUT_SIZE - 0.5)).all(-1).float()
    return ((entropy + distance_weight * distance) * inside).sum() / inside.sum().clamp(min=1)
