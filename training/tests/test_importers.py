"""Poses written as other tools write them come back the same."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from conftest import OBJECTS_ON_BOARD, TAG_MM, run
from scipy.spatial.transform import Rotation

from benches.formats import (
    FLANGE_FROM_CAMERA,
    write_camera,
    write_colmap_binary,
    write_colmap_text,
    write_pairs,
    write_robot,
    write_transforms,
)
from benches.poses import differences, scene_poses
from posed_train import bop
from posed_train.render.layout import CAMERA_MATRIX


def check_same(project, photos, scale=1.0, degrees=0.001, millimetres=0.01):
    found = scene_poses(project / "train/000000")
    assert set(found) == set(photos.names)
    turned, moved, by = differences([found[name] for name in photos.names], photos.camera_from_world)
    assert turned.max() < degrees and moved.max() < millimetres and abs(by - scale) < 0.02 * millimetres
    camera = json.loads((project / "train/000000/scene_camera.json").read_text())["0"]
    np.testing.assert_allclose(np.array(camera["cam_K"]).reshape(3, 3), CAMERA_MATRIX, atol=1e-6)


def test_transforms_come_back(board_photos, tmp_path):
    write_transforms(board_photos, tmp_path / "transforms.json")
    run("new", tmp_path / "cube", "--transforms", tmp_path / "transforms.json", "--unit-mm", 1000)
    check_same(tmp_path / "cube", board_photos)


@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
def test_colmap_comes_back(board_photos, tmp_path, write):
    write(board_photos, tmp_path / "model/sparse/0")
    run("new", tmp_path / "cube", board_photos.folder, "--colmap", tmp_path / "model", "--unit-mm", 1000)
    check_same(tmp_path / "cube", board_photos)


@pytest.mark.parametrize("vectors", [False, True])
def test_a_robots_poses_come_back(board_photos, tmp_path, vectors):
    rows, camera = (
        write_robot(board_photos, tmp_path / "rows.csv", 0.001, vectors),
        write_camera(board_photos, tmp_path / "camera.json"),
    )
    x, y, z, w = Rotation.from_matrix(FLANGE_FROM_CAMERA[:3, :3]).as_quat().tolist()
    shift = " ".join(repr(float(v)) for v in 1000 * FLANGE_FROM_CAMERA[:3, 3])
    told = ["--flange-from-camera", f"{shift} {x!r} {y!r} {z!r} {w!r}", "--camera", camera, "--unit-mm", 1]
    run("new", tmp_path / "cube", board_photos.folder, "--poses", rows, *told)
    check_same(tmp_path / "cube", board_photos)


def test_tags_tell_where_the_camera_is_on_the_flange(board_photos, tmp_path, capsys):
    rows, camera = (
        write_robot(board_photos, tmp_path / "rows.csv"),
        write_camera(board_photos, tmp_path / "camera.json"),
    )
    run("new", tmp_path / "cube", board_photos.folder, "--poses", rows, "--camera", camera, "--tag-mm", TAG_MM)
    check_same(tmp_path / "cube", board_photos, degrees=0.05, millimetres=0.3)
    assert "camera on the flange by 30 photos" in capsys.readouterr().out


def test_a_board_that_was_moved_in_the_robots_base_is_told(board_photos, tmp_path):
    moved = np.eye(4)
    moved[:3, 3] = 0.03, 0.01, 0
    poses = [pose if k < 12 else pose @ moved for k, pose in enumerate(board_photos.camera_from_world)]
    rows = write_robot(replace(board_photos, camera_from_world=poses), tmp_path / "rows.csv")
    camera = write_camera(board_photos, tmp_path / "camera.json")
    with pytest.raises(SystemExit, match=r"moved after IMG_11\.jpg \(before IMG_12\.jpg\): two components"):
        run("new", tmp_path / "cube", board_photos.folder, "--poses", rows, "--camera", camera, "--tag-mm", TAG_MM)


def test_bop_comes_back_with_its_labels(labelled, tmp_path):
    # Numbers with gaps, and masks by their place, as BOP has them.
    run("new", tmp_path / "cube", "--bop", labelled / "train", "--objects", *OBJECTS_ON_BOARD)
    old, new = labelled / "train/000000", tmp_path / "cube/train/000000"
    for name in ("scene_gt", "scene_gt_info"):
        assert json.loads((old / f"{name}.json").read_text()) == json.loads((new / f"{name}.json").read_text())
    before, after = (json.loads((scene / "scene_camera.json").read_text()) for scene in (old, new))
    for key in before:
        found, true = (bop.stated_pose(cameras[key], "w2c") for cameras in (after, before))
        assert np.abs(found - true).max() < 1e-9
    assert len(bop.read_views(tmp_path / "cube/train", 2)) == len(bop.read_views(labelled / "train", 2))
    with pytest.raises(SystemExit, match="has objects 1, 2"):
        run("new", tmp_path / "other", "--bop", labelled / "train")
    assert not (tmp_path / "other").exists()


def test_pairs_apart_are_components(board_photos, tmp_path):
    pairs = [(k, k + 1) for k in range(0, 10, 2)]
    run("new", tmp_path / "cube", board_photos.folder, "--pairs", write_pairs(board_photos, tmp_path, pairs), "--apart")
    true = board_photos.camera_from_world
    for number, (left, right) in enumerate(pairs):
        poses = scene_poses(tmp_path / f"cube/train/{number:06d}")
        a, b = (poses[board_photos.names[k]] for k in (left, right))
        np.testing.assert_allclose(b @ np.linalg.inv(a), true[right] @ np.linalg.inv(true[left]), atol=1e-8)


def test_pairs_that_share_a_scene_are_one_component(board_photos, tmp_path, capsys):
    """No photo is in two pairs. One pair is of another place, and the pose of one is inverted: they stay alone."""
    places = np.stack([np.linalg.inv(pose)[:3, 3] for pose in board_photos.camera_from_world])
    left, pairs = set(range(len(places))), []
    while len(left) > 1:
        apart = {(a, b): np.linalg.norm(places[a] - places[b]) for a in left for b in left if a < b}
        pairs.append(min(apart, key=apart.__getitem__))
        left -= set(pairs[-1])
    photos = tmp_path / "photos"
    shutil.copytree(board_photos.folder, photos)
    rng = np.random.default_rng(3)
    elsewhere = [board_photos.names[k] for k in pairs[0]]
    for name in elsewhere:
        noise = cv2.resize(rng.integers(0, 255, (60, 80, 3), np.uint8), (640, 480))
        cv2.imwrite(str(photos / name), noise)
    file = write_pairs(board_photos, tmp_path, pairs)
    values = json.loads(file.read_text())
    relative = values["pairs"][1]["right_from_left"]
    relative["translation_m"] = [-value for value in relative["translation_m"]]
    file.write_text(json.dumps(values))
    run("new", tmp_path / "cube", photos, "--pairs", file)
    said = capsys.readouterr().out
    inverted = [board_photos.names[k] for k in pairs[1]]
    assert f"{len(pairs)} pairs joined" in said and f"1 pairs are not as their photos show them: {inverted[0]}" in said
    assert elsewhere[0] in said.split("pairs between it and those of ")[1]
    found = scene_poses(tmp_path / "cube/train/000000")
    # The last pairs are of photos far from each other, which share little; and all tags look alike.
    assert len(found) >= 2 * (len(pairs) - 9) and not {*elsewhere, *inverted} & found.keys()
    true = dict(zip(board_photos.names, board_photos.camera_from_world))
    degrees, millimetres, scale = differences(list(found.values()), [true[name] for name in found])
    assert degrees.max() < 0.3 and millimetres.max() < 2 and abs(scale - 1) < 0.005


def test_pairs_that_share_nothing_are_told(board_photos, tmp_path, capsys):
    photos = tmp_path / "photos"
    shutil.copytree(board_photos.folder, photos)
    rng = np.random.default_rng(3)
    for name in board_photos.names[:8]:
        cv2.imwrite(str(photos / name), cv2.resize(rng.integers(0, 255, (60, 80, 3), np.uint8), (640, 480)))
    pairs = write_pairs(board_photos, tmp_path, [(0, 1), (2, 3), (4, 5), (6, 7)])
    run("new", tmp_path / "cube", photos, "--pairs", pairs)
    assert "4 pairs of which no two share enough of a scene" in capsys.readouterr().out


def test_an_unknown_scale_is_told_by_tags_or_points(board_photos, tmp_path):
    write_transforms(board_photos, tmp_path / "transforms.json", unit=0.37)
    with pytest.raises(SystemExit, match="scale of these poses is not known"):
        run("new", tmp_path / "cube", "--transforms", tmp_path / "transforms.json")
    run("new", tmp_path / "cube", "--transforms", tmp_path / "transforms.json", "--tag-mm", TAG_MM)
    found = scene_poses(tmp_path / "cube/train/000000")
    scale = differences([found[n] for n in board_photos.names], board_photos.camera_from_world)[2]
    assert abs(scale - 1) < 0.003

    ends = np.array([[-0.1, -0.1, 0], [0.1, 0.1, 0]])
    clicks = {"mm": 1000 * float(np.linalg.norm(ends[1] - ends[0]))}
    for end, point in zip("ab", ends):
        clicks[end] = {}
        for k in (0, 1, 2):
            pose = board_photos.camera_from_world[k]
            pixel = CAMERA_MATRIX @ (pose[:3, :3] @ point + pose[:3, 3])
            clicks[end][board_photos.names[k]] = (pixel[:2] / pixel[2]).tolist()
    (tmp_path / "points.json").write_text(json.dumps(clicks))
    told = ["--distance", tmp_path / "points.json"]
    run("new", tmp_path / "two", "--transforms", tmp_path / "transforms.json", *told)
    check_same(tmp_path / "two", board_photos)


def test_a_polynomial_of_four_terms_is_taken_over(board_photos):
    from posed_train.onboard.from_transforms import rational

    k1, k2, k3, k4 = -0.2, 0.06, -0.02, 0.004
    lens = rational(k1, k2, k3, k4, 0, 0, reach=0.7)
    import cv2

    points = np.column_stack([np.linspace(0, 0.69, 50), np.zeros(50), np.ones(50)])
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.diag([600.0, 600, 1]), lens)
    r2 = points[:, 0] ** 2
    expected = 600 * points[:, 0] * (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4)
    assert np.abs(pixels[:, 0, 0] - expected).max() < 0.02


def test_what_cannot_be_read_is_said(board_photos, tmp_path):
    def refused(match, *words):
        with pytest.raises(SystemExit, match=match):
            run("new", tmp_path / "cube", *words)
        assert not (tmp_path / "cube").exists()

    transforms = tmp_path / "transforms.json"
    write_transforms(board_photos, transforms, camera_model="OPENCV_FISHEYE")
    refused("OPENCV_FISHEYE", "--transforms", transforms, "--unit-mm", 1000)
    write_transforms(board_photos, transforms, w=1920, h=1080)
    refused("another aspect ratio", "--transforms", transforms, "--unit-mm", 1000)
    for text in ("{", "[]", '{"frames": [{}]}', '{"frames": [{"file_path": "../x.jpg", "transform_matrix": [[1]]}]}'):
        transforms.write_text(text)
        refused("transforms.json", "--transforms", transforms, "--unit-mm", 1000)
    write_transforms(board_photos, transforms)
    values = json.loads(transforms.read_text())
    values["frames"][3]["file_path"] = "../../etc/passwd"
    transforms.write_text(json.dumps(values))
    refused("no photo '../../etc/passwd", "--transforms", transforms, "--unit-mm", 1000)
    refused("no COLMAP model", "--colmap", tmp_path, "--unit-mm", 1000)
    broken = tmp_path / "broken"
    write_colmap_binary(board_photos, broken)
    (broken / "images.bin").write_bytes((broken / "images.bin").read_bytes()[:300])
    refused("images.bin: broken", board_photos.folder, "--colmap", broken, "--unit-mm", 1000)
    rows = tmp_path / "rows.csv"
    rows.write_text("IMG_0.jpg 1 2 3 4\n")
    refused("line 1: needs x y z", board_photos.folder, "--poses", rows, "--tag-mm", TAG_MM)
    rows.write_text("IMG_0.jpg 1 2 3 0 0 0 2\n")
    refused("quaternion's length", board_photos.folder, "--poses", rows, "--tag-mm", TAG_MM)
    (tmp_path / "pairs.json").write_text('{"pairs": []}')
    refused("not a file of pairs", "--pairs", tmp_path / "pairs.json")
    for change, words in (
        ({"right": board_photos.names[0]}, "IMG_0.jpg twice"),
        ({"left": 5}, "pair 0: needs left and right"),
        ({"right_from_left": {"rotation_xyzw": [0, 0, 0, 1], "translation_m": [0, 0, 0]}}, "no distance between"),
        (
            {"right_from_left": {"rotation_xyzw": [0, 0, 0, 1], "translation_m": [120, 0, 0]}},
            "120 m apart.*--unit-mm 1",
        ),
    ):
        pairs = write_pairs(board_photos, tmp_path, [(0, 1)])
        values = json.loads(pairs.read_text())
        values["pairs"][0] |= change
        pairs.write_text(json.dumps(values))
        refused(words, board_photos.folder, "--pairs", pairs)
    refused("give a folder of photos")
