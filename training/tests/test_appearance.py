"""Colours, light and cameras of training crops."""

import colorsys

import numpy as np
import pytest

from posed_train.camera import compress, flicker, motion, noise, split_colours, vary_camera
from posed_train.colour import hue_turn, merge_hues, other_camera, temperature_gains, vary_colour
from posed_train.light import light_field

SIZE = 64
RED, ORANGE, BLUE, GREY = (200, 20, 20), (230, 120, 20), (20, 40, 210), (128, 128, 128)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.fixture
def stripes() -> np.ndarray:
    """Of four colours, from the top to the bottom."""
    return np.repeat(np.array([RED, ORANGE, BLUE, GREY], np.uint8), SIZE // 4, axis=0)[:, None].repeat(SIZE, axis=1)


def hue_deg(colour: np.ndarray) -> float:
    return 360 * colorsys.rgb_to_hsv(*(colour / 255))[0]


def test_without_strength_nothing_changes(rng, stripes):
    same = vary_colour(stripes, rng, 0.0)
    np.testing.assert_allclose(same, stripes, atol=0.01)
    np.testing.assert_array_equal(vary_camera(stripes.astype(np.float32), rng, 0.0), stripes)


def test_lamps_are_warm_and_skies_cold():
    np.testing.assert_allclose(temperature_gains(6500), 1, atol=1e-9)
    red, green, blue = temperature_gains(2700)
    assert red > 1.3 and red > green > blue and blue < 0.6
    red, _, blue = temperature_gains(9500)
    assert 0.75 < red < 0.95 < blue


def test_hues_turn_about_grey():
    np.testing.assert_allclose(hue_turn(np.radians(120)) @ [9, 0, 0], [0, 9, 0], atol=1e-9)
    np.testing.assert_allclose(hue_turn(0.3) @ [5, 5, 5], [5, 5, 5])


def test_other_cameras_see_other_colours_that_stay_colours(rng, stripes):
    crops = np.stack([vary_colour(stripes, rng, 1.0) for _ in range(200)])
    greys = crops[:, -1, 0]
    assert 0.15 < np.std(np.log(greys[:, 0].clip(1) / greys[:, 2].clip(1))) < 0.8
    assert np.ptp(crops.mean((1, 2, 3))) > 60 and (crops.mean((1, 2, 3)) < 215).all()
    # Red is still redder than blue, nearly always.
    redness = crops[:, :, 0, 0] - crops[:, :, 0, 2]
    assert (redness[:, 2] < redness[:, 40]).mean() < 0.05
    assert np.isfinite(other_camera(rng)).all()


def test_merged_hues_become_equal_and_others_stay(rng, stripes):
    merged = 0
    for _ in range(200):
        crop = merge_hues(stripes, None, rng)
        red, orange, blue, grey = (crop[row, 0].astype(float) for row in (2, 20, 40, 60))
        np.testing.assert_array_equal(grey, GREY)
        assert abs(hue_deg(blue) - hue_deg(np.array(BLUE))) < 26
        merged += abs(hue_deg(red) - hue_deg(orange)) % 359 < 4
    assert merged > 10
    grey = np.full((8, 8, 3), 90, np.uint8)
    np.testing.assert_array_equal(merge_hues(grey, None, rng), grey)


def test_hues_merge_about_the_objects_own(rng, stripes):
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[32:48] = 255  # blue
    for _ in range(30):
        assert np.abs(merge_hues(stripes, mask, rng)[:32].astype(int) - stripes[:32]).max() < 8, "but for rounding"


def test_light_comes_from_a_side(rng):
    fields = [light_field(SIZE, rng) for _ in range(60)]
    assert all(field.shape == (SIZE, SIZE, 3) and field.min() > 0 for field in fields)
    assert 0.6 < np.mean(fields) < 1.2
    sides = [np.log(field[:, :8].mean() / field[:, -8:].mean()) for field in fields]
    assert np.std(sides) > 0.2 and abs(np.mean(sides)) < 0.3
    coloured = [np.ptp(np.log(field.mean((0, 1)))) > 0.05 for field in fields]
    assert 5 < sum(coloured) < 40
    steps = [np.abs(np.diff(field, axis=0)).max() for field in fields]
    assert max(steps) < 0.4, "soft"


def test_noise_follows_brightness(rng):
    halves = np.zeros((SIZE, SIZE, 3), np.float32)
    halves[:, SIZE // 2 :] = 240
    drawn = np.stack([noise(halves, rng) for _ in range(40)])
    assert drawn[:, :, SIZE // 2 :].std() > 1.5 * drawn[:, :, : SIZE // 2].std() > 1
    assert abs(drawn.mean()) < 0.3


def test_motion_blurs_along_itself():
    kernel = motion(6.0, np.radians(30))
    reach = len(kernel) // 2
    down, across = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    spread = np.cov(np.stack([across.ravel(), down.ravel()]), aweights=kernel.ravel())
    values, vectors = np.linalg.eigh(spread)
    assert kernel.sum() == pytest.approx(1) and values[1] == pytest.approx(36 / 12, rel=0.3) and values[0] < 0.5
    assert abs(vectors[:, 1] @ [np.cos(np.radians(30)), np.sin(np.radians(30))]) > 0.99


def test_cameras_keep_green_in_its_place_and_channels_in_theirs(rng, stripes):
    crop = stripes.astype(np.float32)
    split = split_colours(crop, rng)
    np.testing.assert_array_equal(split[..., 1], crop[..., 1])
    assert np.abs(split[..., 0] - crop[..., 0]).max() > 0
    wide = np.tile(crop, (1, 2, 1))[:, : SIZE + 20]
    assert split_colours(wide, rng).shape == noise(wide, rng).shape == wide.shape
    again = compress(stripes, 90).astype(int)
    assert np.abs(again - stripes).mean() < 4
    rows = flicker(SIZE, rng)
    assert rows.shape == (SIZE, 1, 1) and 0.7 < rows.min() < rows.max() < 1.3
