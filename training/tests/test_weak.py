"""What a training says of its weaknesses."""

from pathlib import Path

import numpy as np
import pytest

from posed_train.bop import View
from posed_train.onboard.coverage import Coverage
from posed_train.onboard.expect import expect
from posed_train.onboard.judged import Judged, Judgement, Network
from posed_train.onboard.weak import advice
from posed_train.pnp import Solved, stepped
from posed_train.spread import Deviation

EXPECTED = np.eye(4)
EXPECTED[:3, 3] = 0, 0, 0.5


def photo(number, degrees=2.0, mm=4.0, sigma=1.0, elevation=45.0, distance=0.5, visible=1.0, side=150.0):
    view = View("train", "000000", number, Path(), None, np.eye(3), None, EXPECTED, (0, 0, side, side), visible)
    step = np.array([0, 0, mm / 1000, np.radians(degrees), 0, 0])
    found = stepped(EXPECTED, step) if np.isfinite(degrees) else None
    covariance = np.diag([0.004, 0.004, 0.004, 0.035, 0.035, 0.035]) ** 2 * sigma**2
    solved = None if found is None else Solved(found, covariance, 8)
    return Judged(view, f"IMG_{number}.jpg", solved, Deviation(found, EXPECTED), 30.0 * number, elevation, distance)


def around(count=200, lowest=5.0):
    rng = np.random.default_rng(0)
    return Coverage(rng.uniform(0, 360, count), rng.uniform(lowest, 85, count), np.full(count, 0.5))


def found(photos, seen=None, count=200):
    seen = {"000000": seen or around(count)}
    views = [photo(k).view for k in range(count)]
    names = {("000000", k): f"IMG_{k}.jpg" for k in range(count)}
    return Judgement(Network(Path(), {"input": {"size": 160}}), None, None, views, photos, seen, names)


def said(*arguments, **more) -> str:
    return "\n".join(advice(found(*arguments, **more)))


def test_a_good_net_is_only_told_of_other_places():
    (only,) = advice(found([photo(k) for k in range(20)]))
    assert "one place and one light" in only


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ({"elevation": 15.0}, "from below 30 degrees, 6.0 degrees and 12.0 mm in the median of 5 photos"),
        ({"distance": 0.9}, "from beyond 0.63 m, 6.0 degrees"),
        ({"distance": 0.9, "side": 40.0}, "the object is small there"),
        ({"visible": 0.5}, "where something hides a part of it"),
    ],
)
def test_photos_of_a_kind_that_are_worse_are_named(kind, words):
    good = [photo(k) for k in range(10)]
    assert words in said(good + [photo(10 + k, 6.0, 12.0, **kind) for k in range(5)])
    assert words not in said(good + [photo(10 + k, 2.2, 5.0, **kind) for k in range(5)])


def test_photos_without_agreement_are_named():
    photos = [photo(k) for k in range(12)] + [photo(12, np.inf), photo(13, 170.0)]
    text = said(photos)
    assert "2 of 14 held-out photos do not agree with the others (IMG_12.jpg, IMG_13.jpg)" in text
    assert "symmetries" in text


def test_directions_without_photos_are_told_by_the_nearest_photos():
    seen = around(lowest=32.0)
    text = said([photo(k) for k in range(12)], seen)
    assert "12 of the directions around the object have no photo, 12 of them below 30 degrees" in text
    assert "lower" in text and "IMG_" in text


def test_covariances_that_are_too_small_are_told():
    assert "NEES" in said([photo(k, sigma=0.2) for k in range(8)])
    assert "NEES" not in said([photo(k) for k in range(8)])


def test_few_photos_and_none_held_out_are_told():
    assert "40 photos are few" in said([photo(k) for k in range(8)], count=40)
    assert "no photo was held out" in said([])


def test_errors_grow_with_the_distance_once_pixels_are_few():
    """At 106 px the object has as many pixels as the net's crop, less its margin."""
    rows = expect(found([photo(k, degrees=2.0, mm=5.0, side=320.0) for k in range(6)]), (1, 2, 3, 6, 12))
    degrees, depth = [row.degrees for row in rows], [row.depth_mm for row in rows]
    assert [round(row.side_px) for row in rows] == [320, 160, 107, 53, 27]
    assert degrees == pytest.approx([2, 2, 2, 4, 8]) and depth == pytest.approx([5, 10, 15, 60, 240])
    assert [row.photographed for row in rows] == [True, False, False, False, False]
    assert expect(found([photo(k, np.inf) for k in range(6)])) == []
