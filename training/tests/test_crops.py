from pathlib import Path

import numpy as np
from PIL import Image

from posed_train.crops import Square

PARITY = Path(__file__).parents[2] / "tests" / "data" / "crop_parity"


def test_crop_pixels_lie_where_to_crop_says():
    image = np.zeros((150, 200, 3), np.uint8)
    image[..., 0], image[..., 1] = np.arange(200)[None, :], np.arange(150)[:, None]
    square = Square.around((60.3, 40.8, 50, 30), 1.5)
    crop = square.cut(image, 128).astype(float)
    for at in np.array([[70.0, 50.0], [85.0, 60.0], [100.0, 66.0]]):
        u, v = square.to_crop(at, 128)
        assert np.abs(crop[round(v), round(u), :2] - at).max() < 1


def test_outside_the_image_is_black():
    crop = Square.around((-30, 40, 40, 40), 1.5).cut(np.full((100, 100, 3), 200, np.uint8), 64)
    assert crop[32, 2].max() == 0 and crop[32, 62].min() == 200


def test_parity_fixture_is_what_this_code_makes():
    """The Rust service is tested against the same files."""
    image = np.asarray(Image.open(PARITY / "image.png"))
    for name, box in (("shrunk", (20.5, 11.25, 150.0, 97.0)), ("grown_beyond_the_border", (150.0, 80.5, 60.0, 44.0))):
        expected = np.asarray(Image.open(PARITY / f"{name}.png"))
        np.testing.assert_array_equal(Square.around(box, 1.5).cut(image, 64 if name == "shrunk" else 160), expected)
