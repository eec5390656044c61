"""Tiny rendered data sets, made once for all tests."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch  # noqa: F401  Before MuJoCo: Mesa's LLVM and Triton's crash in the other order.

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

    @property
    def matrix(self) -> np.ndarray:
        from posed_train.render.layout import CAMERA_MATRIX

        return CAMERA_MATRIX

    width, height = 640, 480


OBJECTS_ON_BOARD = ("cube", "motor")
TAG_MM = 26.0


def run(*words) -> None:
    """A command of posed-train's."""
    from posed_train import cli

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["posed-train", *map(str, words)])
        cli.main()


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


def box_of(mask: np.ndarray) -> list[int]:
    return list(cv2.boundingRect(mask))


def whole_in(photos: BoardPhotos, index: int) -> list[int]:
    """Photos that show an object whole, by the masks."""
    whole, others = [], [k for k in range(len(photos.masks[0])) if k != index]
    for number, masks in enumerate(photos.masks):
        x, y, w, h = box_of(masks[index])
        around = cv2.dilate(masks[index], np.ones((9, 9)))
        alone = not any((around & masks[other]).any() for other in others)
        inside = w and x > 2 and y > 2 and x + w < around.shape[1] - 2 and y + h < around.shape[0] - 2
        if alone and inside:
            whole.append(number)
    return whole


@pytest.fixture(scope="session")
def drawn(board_photos) -> dict:
    """Boxes as a person draws them, in three photos from three sides."""
    rng, boxes = np.random.default_rng(2), {}
    for index, name in enumerate(OBJECTS_ON_BOARD):
        chosen = whole_in(board_photos, index)[:3]
        boxes[name] = {
            "boxes": {
                board_photos.names[k]: (
                    np.array(box_of(board_photos.masks[k][index])) + rng.integers(-1, 2, 4)
                ).tolist()
                for k in chosen
            }
        }
    return boxes


@pytest.fixture(scope="session")
def labelled(board_photos, drawn, tmp_path_factory) -> Path:
    """A project of the photos, labelled. Not to be changed: see `project`."""
    folder = tmp_path_factory.mktemp("projects") / "cube"
    run("new", folder, board_photos.folder, "--tag-mm", TAG_MM, "--objects", *OBJECTS_ON_BOARD)
    file = folder.parent / "boxes.json"
    file.write_text(json.dumps(drawn))
    run("label", folder, "--box", file)
    return folder


@pytest.fixture
def project(labelled, tmp_path) -> Path:
    """A copy of the labelled project."""
    return Path(shutil.copytree(labelled, tmp_path / "copy"))
