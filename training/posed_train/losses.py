"""Supervision of heatmaps by the projected virtual keypoints of a registered component."""

import torch
from torch import Tensor
from torch.nn import functional as F

from .heatmap import cell_centres, cell_grid, window_mean

TARGET_SIGMA_PX = 2.5
SCALE_BETA_PX = 0.5


def heatmap_loss(
    logits: Tensor, keypoints: Tensor, input_size: int, distance_weight: float = 0.05, scale_weight: float = 0.0
) -> Tensor:
    """Cross-entropy against a Gaussian at each keypoint, plus a little distance of the decoded keypoints and of their
    common scale.

    `logits` is `[B, N, S, S]`, `keypoints` `[B, symmetries, N, 2]` in crop pixels; of the places that a symmetric
    object leaves open, the one that fits a crop best counts. Distance alone stays collapsed on the centre;
    cross-entropy leaves that plateau within a few hundred steps. Keypoints outside the crop have no target.

    The scale has a weight of its own since the depth of the pose hangs on it alone: it is one direction among the 2 N
    that a distance weighs alike.
    """
    weights = distance_weight, scale_weight
    if keypoints.shape[1] == 1:
        total, inside = loss_by_crop(logits, keypoints[:, 0], input_size, *weights)
    else:
        alike = [loss_by_crop(logits, places, input_size, *weights) for places in keypoints.unbind(1)]
        totals, insides = (torch.stack(values) for values in zip(*alike))
        best = (totals / insides.clamp(min=1)).argmin(0, keepdim=True)
        total, inside = totals.gather(0, best), insides.gather(0, best)
    return total.sum() / inside.sum().clamp(min=1)


def loss_by_crop(
    logits: Tensor, keypoints: Tensor, input_size: int, distance_weight: float, scale_weight: float
) -> tuple[Tensor, Tensor]:
    """Sum of the losses of a crop's keypoints, and how many of them lie inside it; both `[B]`."""
    cells, stride = logits.shape[-1], input_size / logits.shape[-1]
    centres = cell_centres(cells, stride).to(keypoints)
    log_u, log_v = (-0.5 * ((centres - keypoints[..., i, None]) / TARGET_SIGMA_PX) ** 2 for i in (0, 1))
    target = (log_v[..., :, None] + log_u[..., None, :]).flatten(2).softmax(-1)
    log_probability = logits.to(keypoints.dtype).flatten(2).log_softmax(-1)
    entropy = -(target * log_probability).sum(-1)
    decoded, _ = window_mean(log_probability.exp(), cell_grid(cells, stride).to(keypoints))
    distance = F.smooth_l1_loss(decoded, keypoints, reduction="none", beta=stride).sum(-1)
    inside = ((keypoints > -0.5) & (keypoints < input_size - 0.5)).all(-1).float()
    by_keypoint = ((entropy + distance_weight * distance) * inside).sum(-1)
    return by_keypoint + scale_weight * scale_loss(decoded, keypoints, inside) * inside.sum(-1), inside.sum(-1)


def scale_loss(decoded: Tensor, keypoints: Tensor, inside: Tensor) -> Tensor:
    """How much larger or smaller than the keypoints `[B, N, 2]` the decoded ones are as a whole, `[B]`: pixels at
    their distance (root mean square) from their centre, smooth L1."""
    weight = inside[..., None]
    count = weight.sum(1, keepdim=True).clamp(min=1)
    expected, found = ((xy - (xy * weight).sum(1, keepdim=True) / count) * weight for xy in (keypoints, decoded))
    square = (expected**2).sum((1, 2)).clamp(min=1)
    scale = (expected * found).sum((1, 2)) / square
    error = (scale - 1) * (square / count.flatten()).sqrt() * (inside.sum(-1) > 1)
    return F.smooth_l1_loss(error, torch.zeros_like(error), reduction="none", beta=SCALE_BETA_PX)


def soft_argmax(logits: Tensor, input_size: int) -> Tensor:
    """Expected positions `[B, N, 2]` (u, v) in crop pixels (paper, equation 1)."""
    centres = cell_centres(logits.shape[-1], input_size / logits.shape[-1]).to(logits)
    probability = logits.flatten(2).softmax(-1).view(*logits.shape)
    return torch.stack([probability.sum(-2) @ centres, probability.sum(-1) @ centres], dim=-1)
