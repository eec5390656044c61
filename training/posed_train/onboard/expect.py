"""What poses to expect at which distance, by the spread in held-out photos and the focal length.

The net looks at crops of one size. As long as the object has more pixels in the photo than in the crop, keypoints err
by a share of the object's size: rotation and place across the ray err alike at all distances, depth in proportion to
it. Farther away they err by a number of the photo's pixels, and all errors grow with the distance once more.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..crops import CROP_SCALE
from .judged import Judgement

FACTORS = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
LEAST_PHOTOS = 4


@dataclass(frozen=True)
class Expected:
    """Medians."""

    distance_m: float
    side_px: float
    degrees: float
    lateral_mm: float
    depth_mm: float
    photographed: bool
    """At such distances; others are extrapolated."""


def expect(found: Judgement, factors: Sequence[float] = FACTORS) -> list[Expected]:
    """Empty where too few photos agree to tell."""
    agreeing = [one for one in found.held_out if one.deviation.agrees]
    if len(agreeing) < LEAST_PHOTOS:
        return []
    median = lambda values: float(np.median(list(values)))  # noqa: E731
    distance, side = median(one.distance_m for one in agreeing), median(one.side_px for one in agreeing)
    degrees, lateral = median(one.degrees for one in agreeing), median(one.lateral_mm for one in agreeing)
    depth = median(abs(one.depth_mm) for one in agreeing)
    every = np.concatenate([seen.distance_m for seen in found.seen.values()])
    crop_px = found.network.manifest["input"]["size"] / CROP_SCALE

    def coarse(side_px: float) -> float:
        return max(1.0, crop_px / side_px)

    rows = []
    for factor in factors:
        there = side / factor
        growth = coarse(there) / coarse(side)
        within = every.min() <= factor * distance <= every.max()
        values = degrees * growth, lateral * growth, depth * growth * factor
        rows.append(Expected(factor * distance, there, *values, bool(within)))
    return rows
