"""Files of a project that people or programs have spoiled: each is refused with a reason, none with a traceback."""

import json

import cv2
import numpy as np
import pytest
import torch
from conftest import run

from posed_train import agreement, bop, optimise
from posed_train.onboard import project as projects

GOOD = {
    "gt": {"0": [{"obj_id": 1}]},
    "gt_info": {"0": [{"bbox_visib": [10, 10, 40, 40], "visib_fract": 1.0}]},
    "camera": {"0": {"cam_K": [500, 0, 32, 0, 500, 24, 0, 0, 1], "cam_R_w2c": [1, 0, 0, 0, 1, 0, 0, 0, 1]}},
}
GOOD["camera"]["0"]["cam_t_w2c"] = [0, 0, 500]


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "train/000000"
    (folder / "rgb").mkdir(parents=True)
    (folder / "mask_visib").mkdir()
    cv2.imwrite(str(folder / "rgb/000000.png"), np.zeros((48, 64, 3), np.uint8))
    cv2.imwrite(str(folder / "mask_visib/000000_000000.png"), np.full((48, 64), 255, np.uint8))
    for name, content in GOOD.items():
        (folder / f"scene_{name}.json").write_text(json.dumps(content))
    return folder


def entry(name, **changes):
    """A good table, with something of its one entry changed."""
    old = GOOD[name]["0"]
    return {"0": [old[0] | changes]} if isinstance(old, list) else {"0": old | changes}


NAN = float("nan")
SPOILED = {
    "a list": ("gt", [1], "must be a JSON object"),
    "no number": ("gt", {"x": []}, "image x: images are numbers"),
    "no list": ("gt", {"0": {}}, "image 0: must be a list of objects"),
    "words": ("gt_info", {"0": ["a"]}, "image 0: must be a list of objects"),
    "nothing": ("gt_info", {"0": None}, "image 0: must be a list of objects"),
    "box of words": ("gt_info", entry("gt_info", bbox_visib=["a", 1, 2, 3]), "no bbox_visib .* of 4 numbers"),
    "box of NaN": ("gt_info", entry("gt_info", bbox_visib=[NAN] * 4), "no bbox_visib .* of 4 numbers"),
    "visible in words": ("gt_info", entry("gt_info", visib_fract="all"), "visib_fract that is no number"),
    "camera in words": ("camera", {"0": "x"}, "image 0: must be"),
    "matrix of NaN": ("camera", entry("camera", cam_K=[NAN] * 9), "no cam_K of 9 numbers"),
    "rotation of words": ("camera", entry("camera", cam_R_w2c=["a"] * 9), "cam_R_w2c of 9 numbers"),
    "rotation of rows": ("camera", entry("camera", cam_R_w2c=[[1, 0, 0]] * 3), "cam_R_w2c of 9 numbers"),
    "one number": ("camera", entry("camera", cam_R_w2c=3), "cam_R_w2c of 9 numbers"),
    "zeros": ("camera", entry("camera", cam_R_w2c=[0] * 9), "cam_R_w2c is no rotation"),
    "place in words": ("gt", entry("gt", cam_R_m2c=[1, 0, 0, 0, 1, 0, 0, 0, 1], cam_t_m2c=["a"] * 3), "cam_t_m2c of 3"),
}


@pytest.mark.parametrize("spoiled", SPOILED)
def test_a_spoiled_scene_is_refused(scene, spoiled):
    assert len(bop.read_views(scene.parent, 1)) == 1
    name, content, words = SPOILED[spoiled]
    (scene / f"scene_{name}.json").write_text(json.dumps(content))
    with pytest.raises(bop.DatasetError, match=words):
        bop.read_views(scene.parent, 1)


@pytest.mark.parametrize("content", [b"\xff\xfe{", b"[" * 100_000, b"{"])
def test_what_is_not_json_is_refused(scene, content):
    (scene / "scene_gt.json").write_bytes(content)
    with pytest.raises(bop.DatasetError, match=r"scene_gt\.json: not valid JSON"):
        bop.read_views(scene.parent, 1)


def test_masks_that_cannot_be_read_are_named(scene):
    """They are no masks for a training, which would learn the board without a word."""
    path = scene / "mask_visib/000000_000000.png"
    assert agreement.masks_readable(bop.read_views(scene.parent, 1)) == []
    cv2.imwrite(str(path), np.full((10, 10), 255, np.uint8))
    assert "1 masks cannot be read, or are not of their image's size" in str(
        agreement.masks_found(bop.read_views(scene.parent, 1))
    )
    path.write_bytes(b"not a picture")
    assert agreement.masks_readable(bop.read_views(scene.parent, 1))


OBJECT = '[[object]]\nname = "cup"\nobj_id = 1\n'
SETTINGS = {
    "size of words": (OBJECT + 'size_mm = ["a", 1, 2]', "three lengths"),
    "two sizes": (OBJECT + "size_mm = [1.0, 2.0]", "three lengths"),
    "size below 0": (OBJECT + "size_mm = [-1.0, 2.0, 3.0]", "three lengths"),
    "number in words": (OBJECT.replace("1", '"one"'), "obj_id 'one'"),
    "name of digits": (OBJECT.replace('"cup"', "5"), "object name 5"),
    "name of a path": (OBJECT.replace("cup", "../cup"), r"object name '\.\./cup'"),
    "the same number": (OBJECT + OBJECT.replace("cup", "mug"), "same obj_id"),
    "the same name": (OBJECT + OBJECT.replace("1", "2"), "same name"),
    "unknown turn": (OBJECT + 'symmetries = ["q9"]', "symmetry 'q9'"),
    "turn without a list": (OBJECT + 'symmetries = "z"', r'a list, as \["z2"\]'),
    "object of words": ('object = ["cup"]', "needs .*object"),
    "photos of words": ('photos = ["x"]\n' + OBJECT, r"photos must be \[\[photos\]\]"),
}


@pytest.mark.parametrize("spoiled", SETTINGS)
def test_spoiled_settings_are_refused(tmp_path, spoiled):
    (tmp_path / "object.toml").write_text(OBJECT)
    assert projects.load(tmp_path).item("cup").obj_id == 1
    content, words = SETTINGS[spoiled]
    (tmp_path / "object.toml").write_text(content)
    with pytest.raises(bop.DatasetError, match=words):
        projects.load(tmp_path)


def test_spoiled_files_of_drawn_boxes_are_refused(scene, tmp_path):
    (tmp_path / "object.toml").write_text(OBJECT)
    file = tmp_path / "boxes.json"
    for content, words in (
        ("[" * 100_000, "nested too deeply"),
        ('{"bad photos": [["a.jpg"]]}', "list of photos' names"),
    ):
        file.write_text(content)
        with pytest.raises(SystemExit, match=words):
            run("label", tmp_path, "--box", file)


@pytest.mark.parametrize("words", ["--max-px 0", "--max-px -5", "--frames 0", "--tag-mm nan"])
def test_numbers_that_cannot_be_are_refused(tmp_path, words, capsys):
    with pytest.raises(SystemExit):
        run("new", tmp_path / "cup", tmp_path, "--tag-mm", "26", *words.split())
    assert f"argument {words.split()[0]}" in capsys.readouterr().err


def test_checkpoints_that_are_none_are_refused(tmp_path):
    """A full disk or a killed copy leaves such files; people give others."""
    path = tmp_path / "checkpoint.pt"
    for content in (b"", b"junk", b"PK\x03\x04 and no more"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"checkpoint\.pt: not a checkpoint"):
            optimise.load(path, "cpu", ["average"])
    torch.save({"step": 3}, path)
    assert optimise.load(path, "cpu", ["step"]) == {"step": 3}
    with pytest.raises(ValueError, match="has no average"):
        optimise.load(path, "cpu", ["average"])
    with pytest.raises(OSError, match="No such file"):
        optimise.load(tmp_path / "nowhere.pt", "cpu", [])
    other = optimise.Run(torch.nn.Linear(2, 2), 1e-3, 10)
    other.save(path)
    optimise.Run(torch.nn.Linear(2, 2), 1e-3, 10).resume(path, torch.device("cpu"))
    with pytest.raises(ValueError, match="of another network; remove it"):
        optimise.Run(torch.nn.Linear(2, 3), 1e-3, 10).resume(path, torch.device("cpu"))
