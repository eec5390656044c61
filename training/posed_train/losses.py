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
    object leaves open, those nearest to the decoded keypoints count. Distance alone stays collapsed on the centre;
    cross-entropy leaves that plateau within a few hundred steps. Keypoints outside the crop have no target.

    The scale has a weight of its own since the depth of the pose hangs on it alone: it is one direction among the 2 N
    that a distance weighs alike.
    """
    cells, stride = logits.shape[-1], input_size / logits.shape[-1]
    log_probability = logits.to(keypoints.dtype).flatten(2).log_softmax(-1)
    decoded, _ = window_mean(log_probability.exp(), cell_grid(cells, stride).to(keypoints))
    keypoints, inside = nearest_alike(decoded.detach(), keypoints, input_size)
    entropy = cross_entropy(log_probability.unflatten(2, (cells, cells)), keypoints, stride)
    distance = F.smooth_l1_loss(decoded, keypoints, reduction="none", beta=stride).sum(-1)
    count = inside.sum(-1)
    by_crop = ((entropy + distance_weight * distance) * inside).sum(-1)
    by_crop = by_crop + scale_weight * scale_loss(decoded, keypoints, inside) * count
    return by_crop.sum() / count.sum().clamp(min=1)


def nearest_alike(decoded: Tensor, keypoints: Tensor, input_size: int) -> tuple[Tensor, Tensor]:
    """Of each crop's equivalent keypoints `[B, symmetries, N, 2]` those nearest to the decoded ones, `[B, N, 2]`, and
    which of them lie inside the crop, `[B, N]` 0 or 1."""
    inside = ((keypoints > -0.5) & (keypoints < input_size - 0.5)).all(-1).to(keypoints)
    apart = (keypoints - decoded[:, None]).norm(dim=-1) * inside
    best = (apart.sum(-1) / inside.sum(-1).clamp(min=1)).argmin(1)
    crops = torch.arange(len(best), device=best.device)
    return keypoints[crops, best], inside[crops, best]


def cross_entropy(log_probability: Tensor, keypoints: Tensor, stride: float) -> Tensor:
    """Against a Gaussian at each keypoint `[B, N, 2]`, which is the product of one in u and one in v; `[B, N]`."""
    centres = cell_centres(log_probability.shape[-1], stride).to(keypoints)
    across, down = (
        (-0.5 * ((centres - keypoints[..., i, None]) / TARGET_SIGMA_PX) ** 2).softmax(-1)[..., None] for i in (0, 1)
    )
    return -((log_probability @ across).transpose(-1, -2) @ down)[..., 0, 0]


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
