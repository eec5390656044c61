"""What the renderers write, read as a user's data set."""

import json
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from posed_train import bop, commands, registration
from posed_train.render.dataset import render_dataset
from posed_train.render.objects import choose_objects, load_objects
from posed_train.render.rasteriser import Rasteriser
from tests.conftest import MODELS

BRACKET = 2


def check_boxes(split: Path) -> None:
    """The mesh, projected with the stated pose and camera, fills the stated box and mask."""
    vertices = trimesh.load(MODELS / f"obj_{BRACKET:06d}.ply", process=False).vertices * 1e-3
    checked = 0
    for view in bop.read_views(split, BRACKET, min_visible=0.98):
        pixels = registration.project(view.camera_matrix, view.camera_from_object, vertices)
        if pixels.min() > 1 and (pixels.max(0) < [638, 478]).all():
            x, y, w, h = view.box
            corners = np.concatenate([pixels.min(0) - [x, y], pixels.max(0) - [x + w - 1, y + h - 1]])
            assert np.abs(corners).max() < 2
            hull = cv2.convexHull(np.rint(pixels).astype(np.int32))
            silhouette = cv2.fillConvexPoly(np.zeros((480, 640), np.uint8), hull, 255)
            assert (bop.read_mask(view) <= cv2.dilate(silhouette, np.ones((3, 3)))).all()
            checked += 1
    assert checked > 0


def test_rasterised_poses_and_boxes_agree(rendered):
    check_boxes(rendered / "train")


@pytest.mark.skipif(not commands.BLENDER_PYTHON.exists(), reason="`make render-env` was not run")
def test_photoreal_poses_and_boxes_agree(tmp_path):
    command = [commands.BLENDER_PYTHON, "-m", "posed_train.render.command", MODELS, tmp_path / "train"]
    subprocess.run([*command, "--engine", "cycles", "--scenes", "1", "--views", "4", "--first", "3"], check=True)
    check_boxes(tmp_path / "train")


def test_a_stopped_run_goes_on(rendered, tmp_path):
    """Finished scenes are kept as they are; the one that lacks its last file is made again, and the same."""
    split = tmp_path / "train"
    shutil.copytree(rendered / "train", split)
    kept, unfinished = split / "000000" / "rgb" / "000000.jpg", split / "000001" / "scene_gt_info.json"
    kept.write_bytes(b"as it was")
    before = json.loads(unfinished.read_text())
    unfinished.unlink()
    render_dataset(Rasteriser, load_objects(MODELS), split, scenes=4, views=4)
    assert kept.read_bytes() == b"as it was"
    assert json.loads(unfinished.read_text()) == before


def test_camouflage_has_the_objects_colours(tmp_path):
    """Hues around the objects come near to theirs; where things stand does not change."""
    parts = [part.colour for item in load_objects(MODELS) for part in item.parts]
    chromaticity = lambda rgb: rgb / rgb.sum(-1, keepdims=True)  # noqa: E731
    own, far, poses = chromaticity(np.array(parts)), {}, {}
    for share in (0.0, 1.0):
        split = tmp_path / str(share)
        render_dataset(Rasteriser, load_objects(MODELS), split, scenes=4, views=1, camouflage=share)
        distances = []
        for scene in sorted(split.iterdir()):
            masks = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (scene / "mask_visib").iterdir()]
            image = bop.read_rgb(scene / "rgb/000000.jpg")
            around = chromaticity(image[(np.max(masks, axis=0) == 0) & (image.min(-1) > 8)][::50].astype(float))
            distances.append(np.linalg.norm(around[:, None] - own, axis=-1).min(1).mean())
        far[share], poses[share] = np.mean(distances), (split / "000000/scene_gt.json").read_text()
    assert far[1.0] < 0.8 * far[0.0]
    assert poses[0.0] == poses[1.0]


def test_copies_of_some_objects(tmp_path):
    """A scene may show one object several times; each has its own place, box and mask."""
    split = tmp_path / "train"
    render_dataset(Rasteriser, choose_objects(load_objects(MODELS), [4, 2], copies=2), split, scenes=1, views=3)
    check_boxes(split)
    for entries in json.loads((split / "000000/scene_gt.json").read_text()).values():
        assert [entry["obj_id"] for entry in entries] == [2, 2, 4, 4]
        assert len({tuple(entry["cam_t_m2c"]) for entry in entries}) == 4
    views = bop.read_views(split, 4)
    assert len({view.mask_path for view in views}) == len(views) > 3


def poses_in_world(scene: Path) -> np.ndarray:
    """`[image, object, 4, 4]`, millimetres."""

    def matrix(entry: dict, name: str) -> np.ndarray:
        rotation, translation = np.reshape(entry[f"cam_R_{name}"], (3, 3)), np.reshape(entry[f"cam_t_{name}"], (3, 1))
        return np.block([[rotation, translation], [0, 0, 0, 1]])

    cameras = json.loads((scene / "scene_camera.json").read_text())
    poses = json.loads((scene / "scene_gt.json").read_text())
    assert len({tuple(camera["cam_t_w2c"]) for camera in cameras.values()}) == len(cameras)
    return np.array(
        [[np.linalg.inv(matrix(cameras[view], "w2c")) @ matrix(one, "m2c") for one in poses[view]] for view in cameras]
    )


def test_a_film_goes_past_a_scene(tmp_path):
    """The camera is elsewhere in every image; in the moving film the first object goes 12 cm, and no other does."""
    objects = choose_objects(load_objects(MODELS), [1, BRACKET], copies=1)
    for film, travelled in (("still", 0), ("moving", 120)):
        render_dataset(Rasteriser, objects, tmp_path / film, scenes=1, views=12, first=6, film=film)
        check_boxes(tmp_path / film)
        world = poses_in_world(tmp_path / film / "000006")
        assert abs(np.linalg.norm(world[-1, 0, :3, 3] - world[0, 0, :3, 3]) - travelled) < 1e-2
        assert np.abs(world[:, 1] - world[0, 1]).max() < 1e-2


def test_refuses_models_that_it_cannot_render(tmp_path):
    with pytest.raises(ValueError, match="no obj_"):
        load_objects(tmp_path)
    shutil.copytree(MODELS, tmp_path / "models")
    (tmp_path / "models" / "metallic.json").write_text('{"2": {"#ff00ff": 1}}')
    with pytest.raises(ValueError, match="#ff00ff"):
        load_objects(tmp_path / "models")
    with pytest.raises(ValueError, match="object 9: not among the models, which have 1, 2, 3, 4"):
        choose_objects(load_objects(MODELS), [1, 9], copies=1)
    with pytest.raises(ValueError, match="at least 1"):
        choose_objects(load_objects(MODELS), None, copies=0)
    with pytest.raises(ValueError, match="at most 5"):
        render_dataset(Rasteriser, choose_objects(load_objects(MODELS), None, copies=2), tmp_path / "train", 1, 1)
    with pytest.raises(ValueError, match="between 0 and 1"):
        render_dataset(Rasteriser, load_objects(MODELS), tmp_path / "train", scenes=1, views=1, camouflage=30)
