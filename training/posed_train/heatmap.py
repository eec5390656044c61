"""Heatmaps of logits to keypoints with covariance. The same module runs in validation and inside the exported graph.

The mean is taken in a window around the highest cell: over the whole map it is pulled towards the crop's centre by
background mass and lies between two peaks. The second moment is taken over the whole map, about that mean, so that
mass elsewhere shows as uncertainty.
"""

import torch
from torch import Tensor, nn

WINDOW_PX = 11


def cell_centres(cells: int, stride: float) -> Tensor:
    """Crop pixels of the centres of a row of heatmap cells (pixel centres at integers)."""
    return (torch.arange(cells, dtype=torch.float32) + 0.5) * stride - 0.5


def cell_grid(cells: int, stride: float) -> Tensor:
    """`[S * S, 2]`: the centre (u, v) of each cell of a heatmap, row by row."""
    centres = cell_centres(cells, stride)
    return torch.stack([centres.repeat(cells), centres.repeat_interleave(cells)], dim=1)


def window_mean(probability: Tensor, grid: Tensor) -> tuple[Tensor, Tensor]:
    """Mean position `[B, N, 2]` of probabilities `[B, N, S * S]` in the window around the highest cell, and what lies
    in that window `[B, N]`."""
    highest = grid[probability.argmax(-1)]  # [B, N, 2]
    away = (grid - highest[:, :, None]).abs().amax(-1)
    window = probability * (away < WINDOW_PX)
    peaks = window.sum(-1)
    return (window / peaks[..., None]) @ grid, peaks


class Decode(nn.Module):
    """`[B, N, S, S]` logits -> keypoints `[B, N, 2]` (u, v) and covariances `[B, N, 2, 2]` in crop pixels, and
    peaks `[B, N]`: the probability inside the window, 0..1."""

    def __init__(self, cells: int, stride: int):
        super().__init__()
        self.register_buffer("grid", cell_grid(cells, stride), persistent=False)

    def forward(self, logits: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        probability = logits.float().flatten(2).softmax(-1)
        keypoints, peaks = window_mean(probability, self.grid)
        offset = self.grid - keypoints[:, :, None]  # [B, N, S * S, 2]
        covariances = (offset * probability[..., None]).transpose(-1, -2) @ offset
        return keypoints, covariances, peaks
