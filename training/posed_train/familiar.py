"""How little a crop looks like those that a net learned from.

The pooled features of training crops lie near a subspace of few dimensions. What of a crop's features lies outside it
tells red and blue exchanged, grey and blurred images from others, where the heatmaps are as sure as ever.
"""

import numpy as np
import torch
from torch import Tensor, nn

from .bop import read_rgb
from .crops import CROP_SCALE, Square, axis_in_image, first_crop, upright
from .data import Views
from .network import KeypointNet

MOST_VIEWS = 400
DIMENSIONS = 24
VIEWS_PER_DIMENSION = 4
TINY = 1e-6


class Unfamiliarity(nn.Module):
    """Features `[B, F]` -> their squared distance from the subspace of features `[V, F]` of training crops, over the
    mean one of these, `[B]`."""

    def __init__(self, features: Tensor):
        super().__init__()
        mean = features.mean(0)
        _, _, axes = torch.linalg.svd(features - mean, full_matrices=False)
        self.register_buffer("mean", mean)
        self.register_buffer("axes", axes[: min(DIMENSIONS, len(features) // VIEWS_PER_DIMENSION)].contiguous())
        self.register_buffer("typical", torch.ones(()))
        self.typical.copy_(self(features).mean().clamp(min=TINY))

    def forward(self, features: Tensor) -> Tensor:
        centred = features - self.mean
        outside = centred - (centred @ self.axes.T) @ self.axes
        return (outside**2).sum(1) / self.typical


@torch.no_grad()
def unfamiliarity(net: KeypointNet, views: Views) -> Unfamiliarity:
    """By photoreal views that were learned from."""
    learned = sorted(set(views.registration.placed) - set(views.held_out))
    learned = [index for index in learned if index < views.photoreal_count]
    net.eval()
    found = []
    for index in learned[:: max(1, len(learned) // MOST_VIEWS)]:
        crop = torch.from_numpy(closest_crop(views, index, net.input_size).copy())
        _, features = net.with_features(crop[None].permute(0, 3, 1, 2).float() / 255)
        found.append(features[0])
    return Unfamiliarity(torch.stack(found))


def closest_crop(views: Views, index: int, size: int) -> np.ndarray:
    """The crop `[S, S, 3]` of the closest look that there is."""
    view = views.all[index]
    if views.heights is None:
        return first_crop(view, size)[0]
    keypoints = views.targets_in_front([index])[0, 0]
    place = Square.about(keypoints).turned(upright(axis_in_image(keypoints, views.heights)))
    return place.scaled(CROP_SCALE).cut(read_rgb(view.image_path), size)
