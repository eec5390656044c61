"""Each trouble changes what it is about, more with its strength, and nothing else."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from posed_train import bop, corrupt


def changed(split: Path, out: Path, trouble: str, strength: int) -> float:
    assert corrupt.corrupt(split, out, trouble, strength, scenes=1) == 4
    (scene,) = out.iterdir()
    apart = []
    for image in sorted((scene / "rgb").iterdir()):
        before = bop.read_rgb(bop.image_path(split / scene.name, int(image.stem)))
        apart.append(np.abs(bop.read_rgb(image).astype(float) - before).mean())
    for name in ("scene_gt.json", "scene_gt_info.json"):
        assert (scene / name).read_text() == (split / scene.name / name).read_text()
    return float(np.mean(apart))


@pytest.mark.parametrize(
    "trouble", [name for name in corrupt.TROUBLES if name not in ("merged", "wrong-camera", "few-bits")]
)
def test_images_suffer_more_from_stronger_trouble(rendered: Path, tmp_path: Path, trouble: str):
    mild = changed(rendered / "train", tmp_path / "mild", trouble, 1)
    strong = changed(rendered / "train", tmp_path / "strong", trouble, 5)
    assert 0 < mild < strong


def test_few_bits_are_the_lower_ones_of_sixteen(rendered: Path, tmp_path: Path):
    corrupt.corrupt(rendered / "train", tmp_path / "out", "few-bits", 1, scenes=1)
    image = cv2.imread(str(next((tmp_path / "out").glob("*/rgb/*.png"))), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16
    assert 1023 < image.max() <= 4095


def test_a_wrong_camera_leaves_the_pixels(rendered: Path, tmp_path: Path):
    assert changed(rendered / "train", tmp_path / "out", "wrong-camera", 5) == 0
    (scene,) = (tmp_path / "out").iterdir()
    before = json.loads((rendered / "train" / scene.name / "scene_camera.json").read_text())
    after = json.loads((scene / "scene_camera.json").read_text())
    for key, camera in before.items():
        ratio = np.array(after[key]["cam_K"])[[0, 4, 2, 5]] / np.array(camera["cam_K"])[[0, 4, 2, 5]]
        np.testing.assert_allclose(ratio, [2, 2, 1, 1])


def test_what_is_there_is_not_written_over(rendered: Path, tmp_path: Path):
    with pytest.raises(OSError, match="exists already"):
        corrupt.corrupt(rendered / "train", tmp_path, "blur", 1)
    with pytest.raises(bop.DatasetError, match="no scene"):
        corrupt.corrupt(tmp_path, tmp_path / "out", "blur", 1)
