"""When a training has learned what its photos teach.

The learning rate of a training falls until its last step, and a net gains from that: no net is at its best while the
rate is high. So a training that no longer gains is not cut off, but cooled down over a few more steps, as it would be
at its end.
"""

from collections.abc import Mapping, Sequence

from .best import Standing

PATIENCE = 1 / 3
"""Share of the steps so far without gain..."""
LEAST_PATIENCE = 1000
"""... and at least so many, after which it is over."""
COOL_DOWN = 0.25
"""Share of the steps so far..."""
LEAST_COOL_DOWN = 300
"""... and at least so many, that it is cooled down for."""
GAIN = 0.03
"""The keypoints' error must fall by that share to count: less is noise."""


def last_gain(rows: Sequence[Mapping[str, str | float]]) -> int | None:
    """The step of the last row of a training's log that did better on held-out photos than all before."""
    best, step = None, None
    for row in rows:
        found = standing_in(row)
        # Where more photos are held out than before, nothing compares with what was.
        if found is not None and (best is None or found.views != best.views or found.better_than(best, GAIN)):
            best, step = found, int(row["step"])
    return step


def standing_in(row: Mapping[str, str | float]) -> Standing | None:
    try:
        return Standing(
            int(row["held_out_photos"]), float(row["held_out_deg5_cm5_percent"]), float(row["held_out_keypoint_px"])
        )
    except (KeyError, TypeError, ValueError):
        return None  # not measured at this step, or by an older version


def cooling(rows: Sequence[Mapping[str, str | float]], step: int, steps: int) -> tuple[int, int] | None:
    """The first and the last step of cooling down, if it is time to; not where the planned end is as near."""
    gained = last_gain(rows)
    if gained is None or step - gained < max(LEAST_PATIENCE, PATIENCE * step):
        return None
    last = step + max(LEAST_COOL_DOWN, round(COOL_DOWN * step))
    return (step, last) if last < steps else None
