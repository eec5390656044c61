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


class Decode(nn.Module):
    """`[B, N, S, S]` logits -> keypoints `[B, N, 2]` (u, v) and covariances `[B, N, 2, 2]` in crop pixels, and
    peaks `[B, N]`: the probability inside the window, 0..1."""

    def __init__(self, cells: int, stride: int):
        super().__init__()
        self.reach = WINDOW_PX
        centres = cell_centres(cells, stride)
        grid = torch.stack([centres.repeat(cells), centres.repeat_interleave(cells)], dim=1)
        self.register_buffer("grid", grid, persistent=False)  # [S * S, 2] as (u, v)

    def forward(self, logits: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        probability = logits.float().flatten(2).softmax(-1)
        highest = self.grid[probability.argmax(-1)]  # [B, N, 2]
        away = (self.grid - highest[:, :, None]).abs().amax(-1)
        window = probability * (away < self.reach)
        peaks = window.sum(-1)
        keypoints = (window / peaks[..., None]) @ self.grid
        offset = self.grid - keypoints[:, :, None]  # [B, N, S * S, 2]
        covariances = (offset * probability[..., None]).transpose(-1, -2) @ offset
        return keypoints, covariances, peaks
