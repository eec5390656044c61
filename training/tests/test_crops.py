from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from posed_train.crops import ZOOM, Square, axis_in_image, look_closer
from posed_train.validate import largest_agreement

PARITY = Path(__file__).parents[2] / "tests" / "data" / "crop_parity"


@pytest.mark.parametrize(
    ("turn", "tolerance"), [(0.0, 1.0), (0.6, 1.2), (-2.5, 1.2)], ids=["upright", "turned", "upside down"]
)
def test_crop_pixels_lie_where_to_crop_says(turn, tolerance):
    """A turned crop is rounded to whole levels twice."""
    image = np.zeros((150, 200, 3), np.uint8)
    image[..., 0], image[..., 1] = np.arange(200)[None, :], np.arange(150)[:, None]
    square = Square.around((60.3, 40.8, 50, 30), 1.5).turned(turn)
    crop = square.cut(image, 128).astype(float)
    for at in np.array([[70.0, 50.0], [85.0, 60.0], [100.0, 66.0]]):
        u, v = square.to_crop(at, 128)
        assert np.abs(crop[round(v), round(u), :2] - at).max() < tolerance


def test_outside_the_image_is_black():
    crop = Square.around((-30, 40, 40, 40), 1.5).cut(np.full((100, 100, 3), 200, np.uint8), 64)
    assert crop[32, 2].max() == 0 and crop[32, 62].min() == 200


@pytest.mark.parametrize(
    ("name", "box", "turn", "size"),
    [
        ("shrunk", (20.5, 11.25, 150.0, 97.0), 0.0, 64),
        ("grown_beyond_the_border", (150.0, 80.5, 60.0, 44.0), 0.0, 160),
        ("turned", (60.25, 40.5, 70.0, 52.0), 0.4, 96),
    ],
)
def test_parity_fixture_is_what_this_code_makes(name, box, turn, size):
    """The Rust service is tested against the same files."""
    image = np.asarray(Image.open(PARITY / "image.png"))
    expected = np.asarray(Image.open(PARITY / f"{name}.png"))
    np.testing.assert_array_equal(Square.around(box, 1.5).turned(turn).cut(image, size), expected)


def test_the_second_box_follows_the_keypoints():
    """Whatever the first box was; where they are no object's, there is none."""
    keypoints = np.array([[100.0, 80], [140, 80], [140, 120], [100, 120]])
    heights = np.array([-1.0, 1, 1, -1])  # the z axis points to the right
    boxes = [Square.around(box, 1.0) for box in ((90, 70, 60, 60), (95, 75, 30, 40), (60, 60, 110, 90))]
    for box in boxes:
        closer = look_closer(keypoints, heights, box)
        np.testing.assert_allclose(closer.centre, [120, 100])
        assert np.isclose(closer.side, ZOOM * np.sqrt(2) * 20)
    for nonsense in (keypoints[:1].repeat(4, 0), 9 * keypoints, keypoints + 200):
        assert look_closer(nonsense, heights, boxes[0]) is None


def test_the_second_crop_shows_the_object_upright():
    rng = np.random.default_rng(4)
    for _ in range(20):
        keypoints, heights = rng.uniform(80, 160, (8, 2)), rng.normal(size=8)
        closer = look_closer(keypoints, heights, Square.around((70, 70, 100, 100), 1.0))
        across, down = axis_in_image(closer.to_crop(keypoints, 128), heights)
        assert abs(across) < 1e-9 and down < 0


def test_squares_keep_their_place():
    whole = Square(-10.0, 4.0, 150.0)
    at = np.array([[33.0, 50.0], [70.2, 41.7]])
    for square in (Square(20.5, 31.0, 60.0), Square(20.5, 31.0, 60.0, 0.7)):
        np.testing.assert_allclose(square.scaled(1.7).turned(0.2).centre, square.centre)
        np.testing.assert_allclose(square.to_image(square.to_crop(at, 128), 128), at)
        # Cut from a cut, pixels lie where they lie when cut at once.
        within = square.within(whole, 300)
        np.testing.assert_allclose(within.to_crop(whole.to_crop(at, 300), 128), square.to_crop(at, 128))


def test_crops_that_disagree_are_left_out():
    rng = np.random.default_rng(0)
    shown, turned = rng.uniform(0, 100, (2, 14, 2))
    near = [shown + rng.normal(0, 1, (14, 2)) for _ in range(2)]
    agreeing = largest_agreement(np.stack([turned, *near]), within=10.0)
    np.testing.assert_array_equal(agreeing, [False, True, True])
    np.testing.assert_array_equal(largest_agreement(np.stack([turned, shown]), within=10.0), [True, False])
