"""Boxes, masks and poses from boxes drawn in three photos, through the command."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import box_of, run

from posed_train import bop
from posed_train.onboard import outlines
from posed_train.onboard import project as projects
from posed_train.onboard.hull import around
from posed_train.onboard.outlines import box_overlap, window_of
from posed_train.onboard.solid import Frame, Solid, bounds, fill, silhouette


def overlap(a, b):
    return (a & b).sum() / max(1, (a | b).sum())


def edges(box):
    x, y, w, h = box
    return np.array([x, y, x + w - 1, y + h - 1])


def labels(project, index):
    """By photo: box, visible fraction and mask."""
    scene = project / "train/000000"
    names, infos = (json.loads((scene / f"{name}.json").read_text()) for name in ("photos", "scene_gt_info"))
    found = {}
    for key, name in names.items():
        mask = cv2.imread(str(scene / f"mask_visib/{int(key):06d}_{index:06d}.png"), 0) > 0
        found[name] = infos[key][index]["bbox_visib"], infos[key][index]["visib_fract"], mask
    return found


@pytest.mark.parametrize("index", [0, 1])
def test_three_drawn_boxes_give_all_boxes_and_masks(board_photos, labelled, index):
    boxes, masks = [], []
    for name, (box, visible, mask) in labels(labelled, index).items():
        true = board_photos.masks[board_photos.names.index(name)][index] > 0
        if visible > 0.9:
            masks.append(overlap(mask, true))
            boxes.append(box_overlap(edges(box), edges(box_of(true.astype(np.uint8)))))
    assert len(masks) > 12
    assert np.median(boxes) > 0.95 and np.percentile(boxes, 10) > 0.9
    assert np.median(masks) > 0.93 and np.percentile(masks, 10) > 0.88


def test_what_hides_an_object_is_no_part_of_it(board_photos, labelled):
    """Where one object stands before the other, masks and visible fractions tell."""
    hidden, masks = [], []
    cube, motor = (labels(labelled, index) for index in (0, 1))
    for name in board_photos.names:
        number = board_photos.names.index(name)
        for mine in (cube, motor):
            _, visible, mask = mine[name]
            if 0.3 < visible < 0.9:
                true = board_photos.masks[number][0 if mine is cube else 1] > 0
                masks.append(overlap(mask, true))
                hidden.append(visible)
        assert not (cube[name][2] & motor[name][2]).any()
    assert len(hidden) >= 2 and np.median(masks) > 0.8


def test_the_box_is_the_objects_size_and_frame(board_photos, labelled):
    cube = projects.load(labelled).item("cube")
    assert np.allclose(cube.size_mm, 54.2, atol=3) and cube.solid == "box"
    scene = labelled / "train/000000"
    names, poses, cameras = (
        json.loads((scene / f"{n}.json").read_text()) for n in ("photos", "scene_gt", "scene_camera")
    )
    world_from_object = [
        np.linalg.inv(bop.stated_pose(cameras[key], "w2c")) @ bop.stated_pose(poses[key][0], "m2c") for key in names
    ]
    np.testing.assert_allclose(world_from_object, np.broadcast_to(world_from_object[0], (len(names), 4, 4)), atol=1e-6)
    # In the middle of the cube: near where the renderer put it, in every photo.
    for key, name in names.items():
        truth = board_photos.camera_from_world[board_photos.names.index(name)] @ board_photos.world_from_object[0]
        found = bop.stated_pose(poses[key][0], "m2c")
        assert np.linalg.norm(found[:3, 3] - truth[:3, 3]) < 0.004
        # z is up: away from the board.
        assert found[:3, 2] @ board_photos.camera_from_world[board_photos.names.index(name)][:3, 2] > 0.999
    views = bop.read_views(labelled / "train", 1, min_visible=0.5)
    assert len(views) > 20 and all(view.mask_path is not None for view in views)
    assert (labelled / "pictures/labels-000000.jpg").stat().st_size > 10_000


def test_objects_can_be_added_one_by_one(project, labelled, drawn, tmp_path):
    before = labels(project, 0)
    again = tmp_path / "motor.json"
    again.write_text(json.dumps({"motor": drawn["motor"]}))
    run("label", project, "--box", again)
    after = labels(project, 0)
    assert all((before[name][2] == after[name][2]).mean() > 0.999 for name in before)
    infos = json.loads((project / "train/000000/scene_gt_info.json").read_text())
    assert all(len(row) == 2 for row in infos.values())


def test_the_3d_box_can_be_told(project, board_photos, tmp_path):
    world_from_cube = board_photos.world_from_object[0]
    from posed_train.render.photos import world_from_board

    # The project's frame has its origin where the board's layout has it: told by the cube's labelled place.
    entry = json.loads((project / "train/000000/scene_gt.json").read_text())["0"][0]
    camera = bop.stated_pose(json.loads((project / "train/000000/scene_camera.json").read_text())["0"], "w2c")
    place = np.linalg.inv(camera) @ bop.stated_pose(entry, "m2c")
    assert world_from_board(board_photos.sheet).shape == world_from_cube.shape
    yaw = float(np.degrees(np.arctan2(-place[1, 0], place[0, 0])))
    told = {"cube": {"base_mm": [1000 * place[0, 3], -1000 * place[1, 3]], "yaw_deg": yaw, "size_mm": [54.2] * 3}}
    file = tmp_path / "told.json"
    file.write_text(json.dumps(told))
    run("label", project, "--box", file)
    assert projects.load(project).item("cube").size_mm == [54.2] * 3
    masks = [
        overlap(mask, board_photos.masks[board_photos.names.index(name)][0] > 0)
        for name, (_, visible, mask) in labels(project, 0).items()
        if visible > 0.9
    ]
    assert np.median(masks) > 0.93


def test_a_solid_that_is_too_narrow_does_not_narrow_the_hull(monkeypatch):
    """Three boxes may fit a solid half as wide as the object; what they leave room for is looked through."""
    bottle = Solid("box", np.array([0.1, 0.2, 0]), 0.6, np.array([0.095, 0.058, 0.191]))
    narrow = replace(bottle, yaw=-0.6, size=np.array([0.059, 0.057, 0.171]))
    frames = [seen_from(bottle.centre, k, turn=35 * k, down=10 + 25 * (k % 3)) for k in range(18)]

    def true_mask(frame, window):
        return fill(window.to_window(silhouette(bottle, frame)), *window.size)

    def look(frames, read, solid, regions):
        return [(frame, window, true_mask(frame, window)) for frame in frames if (window := window_of(solid, frame))]

    monkeypatch.setattr(outlines, "look", look)
    boxes = [(frame, bounds(bottle, frame)) for frame in frames[:3]]
    (near, cramped), (wide, _) = outlines.find_hulls(boxes, narrow, frames, None)
    assert cramped and around(near, narrow).size[0] < 0.08
    np.testing.assert_allclose(around(wide, narrow).size, bottle.size, atol=0.015)


def seen_from(place, number, turn, down, distance=0.6):
    """A camera that looks down at a place."""
    turn, down = np.radians(turn), np.radians(down)
    ahead = -np.array([np.cos(turn) * np.cos(down), np.sin(turn) * np.cos(down), np.sin(down)])
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = -pose[:3, :3] @ (place - distance * ahead)
    matrix = np.array([[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])
    return Frame(number, "", Path(), 640, 480, matrix, pose)


def test_what_cannot_be_drawn_is_said(project, drawn, tmp_path):
    before = {path: path.read_bytes() for path in sorted((project / "train/000000").rglob("*")) if path.is_file()}
    cube = drawn["cube"]["boxes"]
    first, second, third = cube
    near = {name: cube[name] for name in (first, second)}
    cases = {
        "one photo": ({"cube": {"boxes": {first: cube[first]}}}, "2 photos or more"),
        "unknown photo": ({"cube": {"boxes": near | {"IMG_99.jpg": [1, 2, 30, 40]}}}, r"no photo 'IMG_99\.jpg'"),
        "unknown object": ({"cup": drawn["cube"]}, "no object 'cup'"),
        "not numbers": ({"cube": {"boxes": near | {third: [1, 2, "3", 4]}}}, "needs 4 numbers"),
        "no box": ({"cube": {"boxes": near | {third: [1, 2, 0, 4]}}}, "2 px or more"),
        "unknown solid": ({"cube": {"solid": "cone", **drawn["cube"]}}, "solid 'cone'"),
        "another object": (
            {"cube": {"boxes": near | {third: drawn["motor"]["boxes"].get(third, [500, 20, 60, 60])}}},
            "no solid fits",
        ),
        "nothing": ({}, "OBJECT"),
    }
    for name, (content, message) in cases.items():
        file = tmp_path / "bad.json"
        file.write_text(json.dumps(content))
        with pytest.raises(SystemExit, match=message):
            run("label", project, "--box", file)
            pytest.fail(name)
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(SystemExit, match="not valid JSON"):
        run("label", project, "--box", tmp_path / "bad.json")
    with pytest.raises(SystemExit, match="posed-train new"):
        run("label", tmp_path / "nowhere", "--box", tmp_path / "bad.json")
    for entry, message in (
        ({"size_mm": [54] * 3, "base_mm": [1, 2], "scene": "000007"}, "a 3D box must name it"),
        ({**drawn["cube"], "up": "up"}, "choose one of z, y, x"),
        ({**drawn["cube"], "symmetries": ["w3"]}, "half a turn about z"),
        ({**drawn["cube"], "symmetries": "z"}, "symmetries is a list"),
    ):
        (tmp_path / "bad.json").write_text(json.dumps({"cube": entry}))
        with pytest.raises(SystemExit, match=message):
            run("label", project, "--box", tmp_path / "bad.json")
    (tmp_path / "bad.json").write_text(json.dumps({"bad photos": ["IMG_99.jpg"]}))
    with pytest.raises(SystemExit, match=r"bad photos: no photo 'IMG_99\.jpg'"):
        run("label", project, "--box", tmp_path / "bad.json")
    after = {path: path.read_bytes() for path in sorted((project / "train/000000").rglob("*")) if path.is_file()}
    assert after == before, "nothing half-written"
