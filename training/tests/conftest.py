"""Tiny rendered data sets, made once for all tests."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

MODELS = Path(__file__).parents[1] / "demo" / "models"


@pytest.fixture(scope="session")
def rendered(tmp_path_factory) -> Path:
    from posed_train.render.dataset import render_dataset
    from posed_train.render.objects import load_objects
    from posed_train.render.rasteriser import Rasteriser

    root = tmp_path_factory.mktemp("data")
    render_dataset(Rasteriser, load_objects(MODELS), root / "train", scenes=4, views=4)
    return root


@dataclass(frozen=True)
class BoardPhotos:
    """Photos of a cube and a motor on a board, and the truth of them."""

    folder: Path  # of IMG_0.jpg, ...
    names: list[str]
    sheet: object
    camera_from_world: list[np.ndarray]
    masks: list[list[np.ndarray]]
    world_from_object: list[np.ndarray]


OBJECTS_ON_BOARD = ("cube", "motor")
TAG_MM = 26.0


@pytest.fixture(scope="session")
def board_photos(tmp_path_factory) -> BoardPhotos:
    from posed_train.onboard.printing import tag_board
    from posed_train.render import photos
    from posed_train.render.objects import choose_objects, load_objects

    folder, rng = tmp_path_factory.mktemp("photos"), np.random.default_rng(4)
    objects = choose_objects(load_objects(MODELS), [1, 3], 1)
    places = [photos.stand(objects[0], -0.03, 0.04, 0.4), photos.stand(objects[1], 0.03, -0.05, 1.9)]
    sheet, cameras = tag_board("a4", TAG_MM, 0), photos.cameras_around(30, rng, (0.33, 0.5))
    rendered = list(photos.render_photos(objects, places, sheet, cameras, rng))
    names = [f"IMG_{k}.jpg" for k in range(len(rendered))]
    for name, photo in zip(names, rendered):
        cv2.imwrite(str(folder / name), photo.image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
    return BoardPhotos(
        folder, names, sheet, [p.camera_from_world for p in rendered], [p.masks for p in rendered], places
    )
