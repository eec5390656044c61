"""What `check` says of mistakes that people make, each made in a good project."""

import json
import re

import cv2
import numpy as np
import pytest
from conftest import run

from posed_train import bop

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


class Scene:
    """The annotations of a project's scene, to be spoiled."""

    def __init__(self, project):
        self.folder = project / "train/000000"
        self.cameras, self.gt, self.info = (
            json.loads((self.folder / f"scene_{n}.json").read_text()) for n in self.names
        )
        self.keys = sorted(self.cameras, key=int)

    names = ("camera", "gt", "gt_info")

    def save(self):
        for name, content in zip(self.names, (self.cameras, self.gt, self.info)):
            (self.folder / f"scene_{name}.json").write_text(json.dumps(content))

    def matrices(self, change):
        for camera in self.cameras.values():
            camera["cam_K"] = change(np.array(camera["cam_K"]).reshape(3, 3)).ravel().tolist()

    def poses(self, change):
        for camera in self.cameras.values():
            camera.update(bop.pose_entry(change(bop.stated_pose(camera, "w2c")), "w2c"))

    def boxes(self, change):
        for row in self.info.values():
            for info in row:
                if info["bbox_visib"][2] > 0:
                    info["bbox_visib"] = [int(v) for v in change(*info["bbox_visib"])]

    def of_next(self, table, keys):
        values = [json.loads(json.dumps({k: table[key][k] for k in keys} if keys else table[key])) for key in self.keys]
        for key, value in zip(self.keys, values[1:] + values[:1]):
            if keys:
                table[key].update(value)
            else:
                table[key] = value


def scale(matrix, x, y, whole):
    out = matrix.copy()
    out[0, : 3 if whole else 2] *= x
    out[1, : 3 if whole else 2] *= y
    return out


def wrong_poses(scene):
    some = [scene.keys[k] for k in (4, 11, 20)]
    poses = {key: {k: scene.cameras[key][k] for k in ("cam_R_w2c", "cam_t_w2c")} for key in some}
    for key, other in zip(some, some[1:] + some[:1]):
        scene.cameras[key].update(poses[other])


def move_midway(scene):
    """All boxes from the middle on, as if the object had been pushed 4 cm: by how the middle's projection moves."""
    place = None
    for key in scene.keys[:1]:
        world_from_camera = np.linalg.inv(bop.stated_pose(scene.cameras[key], "w2c"))
        place = (world_from_camera @ bop.stated_pose(scene.gt[key][0], "m2c"))[:3, 3]
    for key in scene.keys[len(scene.keys) // 2 :]:
        pose, matrix = bop.stated_pose(scene.cameras[key], "w2c"), np.array(scene.cameras[key]["cam_K"]).reshape(3, 3)
        pixels = []
        for point in (place, place + np.array([0.04, 0.01, 0])):
            seen = matrix @ (pose[:3, :3] @ point + pose[:3, 3])
            pixels.append(seen[:2] / seen[2])
        box = scene.info[key][0]["bbox_visib"]
        if box[2] > 0:
            moved = np.round(np.array(box[:2]) + pixels[1] - pixels[0]).astype(int)
            scene.info[key][0]["bbox_visib"] = [*np.clip(moved, 0, None).tolist(), *box[2:]]
            x, y, w, h = scene.info[key][0]["bbox_visib"]
            scene.info[key][0]["bbox_visib"] = [x, y, min(w, 640 - x), min(h, 480 - y)]


def shift_half(scene):
    scene.boxes(lambda x, y, w, h: (min(x + w // 2, 639 - w), min(y + h // 2, 479 - h), w, h))


def metres(pose):
    out = pose.copy()
    out[:3, 3] /= 1000
    return out


def smaller(pose):
    out = pose.copy()
    out[:3, 3] /= 1.2
    return out


MISTAKES = {
    "f x 1.3": (lambda s: s.matrices(lambda m: scale(m, 1.3, 1.3, False)), r"fx and fy in cam_K are (about )?1\.[234]"),
    "K x 0.5": (
        lambda s: s.matrices(lambda m: scale(m, 0.5, 0.5, True)),
        r"cam_K is of (images 0\.5|another resolution)",
    ),
    "K x 1.5": (
        lambda s: s.matrices(lambda m: scale(m, 1.5, 1.5, True)),
        r"cam_K is of (images 1\.5|another resolution)",
    ),
    "K of another resolution": (
        lambda s: s.matrices(lambda m: scale(m, 3, 2.25, True)),
        r"cam_K .* does not fit an image of 640x480|cam_K is of",
    ),
    "scale / 1.2": (lambda s: s.poses(smaller), r"object measures 8\d % of 54 x 54 x 54 mm: the scale"),
    "boxes shifted by half": (shift_half, "x and y must be the left and upper edge"),
    "boxes of the next photo": (lambda s: s.of_next(s.info, None), "boxes are one photo off"),
    "poses of the next photo": (
        lambda s: s.of_next(s.cameras, ("cam_R_w2c", "cam_t_w2c")),
        "poses are one photo off",
    ),
    "10 % wrong poses": (wrong_poses, r"3 of \d+ photos have a wrong pose.*IMG_(4|11|20)\.jpg"),
    "object moved midway": (move_midway, r"moved \d\d mm after photo IMG_1\d\.jpg"),
    "inverted poses": (lambda s: s.poses(np.linalg.inv), "poses are the wrong way round"),
    "OpenGL axes": (lambda s: s.poses(lambda p: OPENGL @ p), "poses have OpenGL's camera axes"),
    "inverted poses with OpenGL axes": (
        lambda s: s.poses(lambda p: np.linalg.inv(OPENGL @ p)),
        "wrong way round and have OpenGL's camera axes",
    ),
    "metres": (lambda s: s.poses(metres), "thousand times too small"),
    "no rotations": (
        lambda s: s.poses(lambda p: p @ np.diag([-1, 1, 1, 1.0])),
        "rotations are none",
    ),
}


def check(capsys, project):
    """What is printed on a project that is not good."""
    with pytest.raises(SystemExit) as end:
        run("check", project, "--object", "cube", "--size-mm", "54x54x54")
    assert end.value.code != 0
    return capsys.readouterr().out + str(end.value.code)


def test_a_good_project_passes(labelled, capsys):
    run("check", labelled)
    printed = capsys.readouterr().out
    assert printed.endswith("passed\n") and "masks: 30 of 30" in printed and "boxes against poses: 0.0" in printed
    run("check", labelled, "--object", "cube", "--size-mm", "54.2x54.2x54.2")
    assert "size: 9" in (printed := capsys.readouterr().out) or "size: 10" in printed
    with pytest.raises(SystemExit):
        run("check", labelled, "--object", "cube", "--size-mm", "54.2x110x54.2")
    assert "which is another shape than 54.2 x 54.2 x 110 mm" in capsys.readouterr().out


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named(project, capsys, mistake):
    spoil, words = MISTAKES[mistake]
    scene = Scene(project)
    spoil(scene)
    scene.save()
    printed = check(capsys, project)
    assert re.search(words, printed), printed


def test_misnamed_masks_are_named(project, capsys):
    for path in (project / "train/000000/mask_visib").iterdir():
        path.rename(path.with_name(path.name.replace("_", "-")))
    printed = check(capsys, project)
    assert (
        "masks: 0 of" in printed
        and "000000-000000.png" in printed
        and "masks are named as 000000_000000.png" in printed
    )


def test_photos_of_one_scene_without_masks_are_warned_of(project, capsys):
    run("check", project, "--object", "cube")
    assert "no masks" not in capsys.readouterr().out
    for path in (project / "train/000000/mask_visib").iterdir():
        path.unlink()
    run("check", project, "--object", "cube")
    assert "warning: no masks" in capsys.readouterr().out


def test_masks_of_other_objects_are_named(project, capsys):
    folder = project / "train/000000/mask_visib"
    for path in sorted(folder.glob("*_000000.png")):
        cv2.imwrite(str(path), np.roll(cv2.imread(str(path), 0), 150, axis=1))
    assert "masks are not where the boxes are" in check(capsys, project)


def test_broken_scenes_are_said_without_a_traceback(project, capsys):
    scene, keep = Scene(project), Scene(project)
    key = scene.keys[3]
    del scene.cameras[key]
    scene.save()
    assert f"image {int(key)} is in scene_gt.json, but not in scene_camera.json" in check(capsys, project)
    scene = Scene(project)
    scene.cameras = keep.cameras
    for row in scene.info.values():
        for info in row:
            info.pop("visib_fract", None)
    scene.save()
    run("check", project, "--object", "motor")
    assert "visib" not in capsys.readouterr().err, "taken to be seen whole"
    del scene.info[key][0]["bbox_visib"]
    scene.save()
    assert "has no bbox_visib" in check(capsys, project)
    keep.info[key] = []
    keep.save()
    assert "2 objects in scene_gt.json, 0 in" in check(capsys, project)
    Scene(project).cameras.clear()
    (scene.folder / "scene_camera.json").unlink()
    assert "scene_camera.json: missing" in check(capsys, project)
    (scene.folder / "scene_gt_info.json").unlink()
    printed = check(capsys, project)
    assert "no boxes yet" in printed or "no scene_gt_info.json" in printed
    with pytest.raises(SystemExit, match="three lengths"):
        run("check", project, "--object", "cube", "--size-mm", "54")
    with pytest.raises(SystemExit, match="no object 'cup'"):
        run("check", project, "--object", "cup")
    (project / "object.toml").write_text("[[object]\n")
    with pytest.raises(SystemExit, match=r"object\.toml"):
        run("check", project)


@pytest.mark.parametrize("gone_first", [False, True])
def test_masks_without_their_object_are_told(project, board_photos, gone_first, capsys):
    """Boxes and masks found where the object should be fit the poses, whether it is there or not: taken away after some
    photo, or put there."""
    scene = project / "train/000000"
    names = json.loads((scene / "photos.json").read_text())
    for key, name in names.items():
        number = board_photos.names.index(name)
        if (number < 12) == gone_first:
            path = scene / f"rgb/{int(key):06d}.jpg"
            image = cv2.imread(str(path))
            mask = cv2.dilate(board_photos.masks[number][0], np.ones((5, 5)))
            cv2.imwrite(str(path), cv2.inpaint(image, mask, 3, cv2.INPAINT_TELEA))
    with pytest.raises(SystemExit):
        run("check", project, "--object", "cube")
    said = capsys.readouterr().out
    assert "moved after photo IMG_11.jpg (before IMG_12.jpg)" in said and "two components" in said
    run("check", project, "--object", "motor")
