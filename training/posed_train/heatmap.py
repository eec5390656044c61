"""Heatmaps of logits to keypoints with covariance. The same module runs in validation and inside the exported graph.

The mean is taken in a window around the highest cell: over the whole map it is pulled towards the crop's centre by
background mass and lies between two peaks. The second moment is taken over the whole map, about that mean, so that
mass elsewhere shows as uncertainty.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

WINDOW_PX = 11
TINY = 1e-30


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
    window = probability * near(highest, grid)
    peaks = window.sum(-1)
    return (window / peaks[..., None]) @ grid, peaks


def near(pixels: Tensor, grid: Tensor) -> Tensor:
    """Which cells are in the windows around these `[B, N, 2]`, `[B, N, S * S]`."""
    return (grid - pixels[:, :, None]).abs().amax(-1) < WINDOW_PX


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


class SecondPeak(nn.Module):
    """`[B, N, S, S]` logits -> the keypoints `[B, N, 2]` of each heatmap's second peak, crop pixels, and the
    probability of its window over that of the first peak's, `[B, N]`.

    It is the highest cell outside the first peak's window that no neighbour exceeds, decoded in a window of its own
    without what lies in the first one. Heatmaps with one peak have a weight of almost nothing.
    """

    def __init__(self, cells: int, stride: int):
        super().__init__()
        self.register_buffer("grid", cell_grid(cells, stride), persistent=False)

    def forward(self, logits: Tensor) -> tuple[Tensor, Tensor]:
        logits = logits.float()
        probability = logits.flatten(2).softmax(-1)
        first = near(self.grid[probability.argmax(-1)], self.grid)
        is_peak = (logits >= F.max_pool2d(logits, 3, 1, 1)).flatten(2)
        second = self.grid[(probability * is_peak * ~first).argmax(-1)]
        window = probability * (near(second, self.grid) & ~first)
        mass = window.sum(-1)
        mean = (window / mass.clamp(min=TINY)[..., None]) @ self.grid
        keypoints = torch.where(mass[..., None] > 0, mean, second)
        return keypoints, mass / (probability * first).sum(-1)
