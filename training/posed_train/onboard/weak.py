"""What is weak in a net, by its held-out photos and by where its photos were taken from, and what helps."""

from collections.abc import Callable, Sequence

import numpy as np

from .coverage import Coverage
from .judged import NEES_MEDIAN, Judged, Judgement

FEW_PHOTOS = 60
FEW_IN_A_GROUP = 3
MUCH_WORSE = 1.6
"""Than the other photos."""
LOW_DEG = 30.0
HALF_HIDDEN = 0.8
MANY_DISAGREE = 0.1
FALSE_COVARIANCE = 3.0
SMALL_PX = 70.0
MOST_NAMES = 6


def advice(found: Judgement) -> list[str]:
    """What is weak and what to do, the most pressing first; empty where nothing is."""
    held_out = found.held_out
    said = disagreeing(held_out)
    for group in (low, far, hidden):
        said += group(held_out)
    for scene in found.seen:
        said += gaps(found, scene, several=len(found.seen) > 1)
    if not held_out:
        said.append("no photo was held out, so nothing tells how good the net is: add photos (`posed-train add`)")
    elif len(found.views) < FEW_PHOTOS:
        said.append(f"{len(found.views)} photos are few: {FEW_PHOTOS} to 200 learn well (`posed-train add`)")
    if not found.network.trusted:
        said += sure_of_itself(held_out, found.network.widened)
    if len(found.seen) == 1:
        said.append(
            "all photos are of one place and one light: if it is to be found elsewhere, photograph it there, too "
            "(`posed-train add`)"
        )
    return said


def disagreeing(held_out: Sequence[Judged]) -> list[str]:
    wrong = [one for one in held_out if not one.deviation.agrees]
    if len(wrong) <= MANY_DISAGREE * len(held_out):
        return []
    return [
        f"{len(wrong)} of {len(held_out)} held-out photos do not agree with the others ({listed(wrong)}): train longer "
        "(--steps), and add photos from where these were taken; if the object looks the same after some turn, say so "
        "in object.toml (symmetries)"
    ]


def low(held_out: Sequence[Judged]) -> list[str]:
    return worse(
        held_out, lambda one: one.elevation_deg < LOW_DEG, f"from below {LOW_DEG:.0f} degrees", "add low photos"
    )


def far(held_out: Sequence[Judged]) -> list[str]:
    if not held_out:
        return []
    limit = float(np.quantile([one.distance_m for one in held_out], 2 / 3))
    small = float(np.median([one.side_px for one in held_out if one.distance_m >= limit])) < SMALL_PX
    cure = "the object is small there: a longer lens, or more pixels" if small else "add photos from that far"
    return worse(held_out, lambda one: one.distance_m > limit, f"from beyond {limit:.2f} m", cure)


def hidden(held_out: Sequence[Judged]) -> list[str]:
    return worse(
        held_out,
        lambda one: one.view.visible_fraction < HALF_HIDDEN,
        "where something hides a part of it",
        "add photos in which other things stand before it",
    )


def worse(held_out: Sequence[Judged], within: Callable[[Judged], bool], where: str, cure: str) -> list[str]:
    """If photos of a kind are much worse than the others."""
    inside, others = [one for one in held_out if within(one)], [one for one in held_out if not within(one)]
    if min(len(inside), len(others)) < FEW_IN_A_GROUP:
        return []
    here, there = middle(inside), middle(others)
    if not np.isfinite(there).all():
        return []
    if not np.isfinite(here).all():
        return [f"{where}, most of {len(inside)} photos have no pose: {cure}"]
    if np.sqrt(np.prod(here / np.maximum(there, 1e-9))) <= MUCH_WORSE:
        return []
    return [
        f"{where}, {here[0]:.1f} degrees and {here[1]:.1f} mm in the median of {len(inside)} photos, elsewhere "
        f"{there[0]:.1f} and {there[1]:.1f}: {cure}"
    ]


def middle(photos: Sequence[Judged]) -> np.ndarray:
    """Medians in degrees and mm, not finite where half of them have no pose."""
    values = np.array([[one.degrees, one.millimetres] for one in photos])
    return np.sort(values, axis=0)[len(values) // 2]


def gaps(found: Judgement, scene: str, several: bool) -> list[str]:
    seen = found.seen[scene]
    missing = seen.missing()
    if not missing:
        return []
    views = found.of_scene(scene)
    near = dict.fromkeys(found.name(views[nearest(seen, *gap)]) for gap in missing)
    low_ones = sum(elevation < LOW_DEG for _, elevation in missing)
    kinds = f", {low_ones} of them below {LOW_DEG:.0f} degrees" if low_ones else ""
    within = f" of scene {scene}" if several else ""
    return [
        f"{len(missing)} of the directions around the object{within} have no photo{kinds}: add some near "
        f"{', '.join(list(near)[:MOST_NAMES])}, {'lower' if low_ones > len(missing) / 2 else 'from further around'}"
    ]


def nearest(seen: Coverage, azimuth_deg: float, elevation_deg: float) -> int:
    """The photo that looks from nearest to a direction."""
    there = unit(np.array([azimuth_deg]), np.array([elevation_deg]))
    return int((unit(seen.azimuth_deg, seen.elevation_deg) @ there[0]).argmax())


def unit(azimuth_deg: np.ndarray, elevation_deg: np.ndarray) -> np.ndarray:
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)


def sure_of_itself(held_out: Sequence[Judged], widened: dict[str, float] | None) -> list[str]:
    nees = [one.nees for one in held_out if one.deviation.agrees]
    if len(nees) < FEW_IN_A_GROUP or np.median(nees) < FALSE_COVARIANCE * NEES_MEDIAN:
        return []
    told = f"NEES {np.median(nees):.0f} in the median, {NEES_MEDIAN} if it were right"
    words = f"poses scatter more than the solver says ({told}): "
    if widened is None:
        return [words + "do not rely on covariances; more photos help"]
    return [words + f"the service widens standard deviations up to {max(widened.values()):.1f} times; more photos help"]


def listed(photos: Sequence[Judged]) -> str:
    names = [one.name for one in photos]
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return ", ".join(names[:MOST_NAMES]) + more
