"""What other cameras would see of an object, against an ellipsoid of which that is known."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from posed_train import bop
from posed_train.config import KeypointConfig
from posed_train.data import Views
from posed_train.novel_views import dataset
from posed_train.novel_views.relight import relight
from posed_train.novel_views.studio import Studio

AXES = np.array([0.05, 0.03, 0.04])
SIZE, FOCAL = 240, 500.0
MATRIX = np.array([[FOCAL, 0, 120], [0, FOCAL, 118], [0, 0, 1]])
SETTINGS = KeypointConfig(name="egg", obj_id=1, photoreal="train", novel_views="new", poses="camera")


def looking(azimuth: float, elevation: float, distance: float = 0.5) -> np.ndarray:
    """`camera_from_world` of a camera that looks at the origin."""
    towards = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    z = -np.array(towards)
    x = np.cross(z, [0, 0, 1])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = [x, np.cross(z, x), z]
    pose[2, 3] = distance
    return pose


def seen(pose: np.ndarray, matrix: np.ndarray, size: int = SIZE) -> tuple[np.ndarray, np.ndarray]:
    """The ellipsoid, each of whose points has a colour of its own, and its mask."""
    pixels = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).reshape(-1, 2)
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(matrix).T @ pose[:3, :3]
    eye = -pose[:3, :3].T @ pose[:3, 3]
    a, b, c = ((rays / AXES) ** 2).sum(1), (rays / AXES**2 * eye).sum(1), ((eye / AXES) ** 2).sum() - 1
    root = b**2 - a * c
    hit = root > 0
    points = eye + ((-b - np.sqrt(np.maximum(root, 0))) / a)[:, None] * rays
    colours = np.where(hit[:, None], 128 + 90 * np.sin(points * [60, 70, 65] + [0, 1, 2]), 20)
    return colours.reshape(size, size, 3).astype(np.uint8), (255 * hit).reshape(size, size).astype(np.uint8)


@pytest.fixture(scope="module")
def egg(tmp_path_factory):
    """A BOP folder with 30 photos, the camera poses alone known."""
    root = tmp_path_factory.mktemp("egg")
    scene = root / "train/000000"
    for sub in ("rgb", "mask_visib"):
        (scene / sub).mkdir(parents=True)
    cameras, poses, infos = {}, {}, {}
    for number in range(30):
        pose = looking(2.4 * number, 0.2 + 1.1 * number / 30, 0.45 + 0.1 * (number % 3))
        rgb, mask = seen(pose, MATRIX)
        bop.write_rgb(scene / f"rgb/{number:06d}.png", rgb)
        bop.write_mask(scene / f"mask_visib/{number:06d}_000000.png", mask)
        cameras[str(number)] = {"cam_K": MATRIX.flatten().tolist(), **bop.pose_entry(pose, "w2c")}
        poses[str(number)] = [{"obj_id": 1}]
        infos[str(number)] = [{"bbox_visib": list(cv2.boundingRect(mask)), "visib_fract": 1.0}]
    bop.write_annotations(scene, cameras, poses, infos)
    return root


def test_a_new_camera_sees_what_it_would_see(egg):
    views = bop.read_views(egg / "train", 1)
    studio = Studio(views, np.stack([view.camera_from_world for view in views]))
    for azimuth, elevation, distance in ((0.7, 0.5, 0.4), (3.0, 0.9, 0.6), (5.1, 0.35, 0.3)):
        pose = looking(azimuth, elevation, distance)
        found = studio.render(pose, MATRIX, 160, 1.2, None)
        rgb, mask = seen(pose, found.camera_matrix, 160)
        both = (mask > 0) & (found.mask > 127)
        assert both.sum() / ((mask > 0) | (found.mask > 127)).sum() > 0.9
        inside = cv2.erode(both.astype(np.uint8), np.ones((7, 7))) > 0
        assert np.abs(found.rgb[inside].astype(int) - rgb[inside]).mean() < 12


def test_the_object_stays_where_the_camera_saw_it(egg):
    views = bop.read_views(egg / "train", 1)
    studio = Studio(views, np.stack([view.camera_from_world for view in views]))
    rng = np.random.default_rng(1)
    for photo in studio.photos[:10]:
        pose = studio.beside(photo, rng)
        before, after = (p[:3, :3] @ studio.shape.middle + p[:3, 3] for p in (photo.camera_from_component, pose))
        assert np.allclose(before / np.linalg.norm(before), after / np.linalg.norm(after))
        assert 0.5 < np.linalg.norm(after) / np.linalg.norm(before) < 1.4
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


def test_new_views_share_the_frame_of_their_photos(egg):
    before = Views(replace(SETTINGS, novel_views=""), egg)
    count = dataset.make(before, SETTINGS, egg, 2)
    assert count == 2 * (30 - len(before.held_out))
    after = Views(SETTINGS, egg)
    assert len(after.all) == 30 + count and len(after.registration.placed) == len(after.all)
    assert after.photoreal_count == 30 and after.held_out == before.held_out
    assert np.allclose(after.registration.keypoints, before.registration.keypoints, rtol=0.1)
    # What was made is not made again, and other photos are another matter.
    file = next((egg / "new/train/000000/rgb").iterdir())
    made = file.stat().st_mtime_ns
    assert dataset.make(before, SETTINGS, egg, 2) == count and file.stat().st_mtime_ns == made
    assert dataset.make(before, SETTINGS, egg, 1) == count // 2
    once = json.loads((egg / "new/train/000000/made_of.json").read_text())
    with (egg / "train/000000/mask_visib/000001_000000.png").open("ab") as mask:
        mask.write(b"another")
    dataset.make(before, SETTINGS, egg, 1)
    assert json.loads((egg / "new/train/000000/made_of.json").read_text()) != once


def test_without_masks_or_with_few_photos_there_are_none(egg, tmp_path):
    few = Views(replace(SETTINGS, novel_views=""), egg)
    few.registration.components[0].views = few.registration.components[0].views[:15]
    assert dataset.make(few, replace(SETTINGS, novel_views="none"), egg, 1) == 0
    with pytest.raises(bop.DatasetError, match="`posed-train novel-views` makes them"):
        Views(replace(SETTINGS, novel_views="nowhere"), egg)


def test_light_falls_on_the_side_that_faces_it():
    normals = np.random.default_rng(0).normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = relight(normals * 0.05, normals, np.array([0, 0, 1.0]), np.random.default_rng(3)).mean(1)
    towards = (normals * (light - light.mean())[:, None]).mean(0)
    towards /= np.linalg.norm(towards)
    lit, shaded = light[normals @ towards > 0.7], light[normals @ towards < -0.7]
    assert lit.mean() > 1.2 * shaded.mean() and light.min() > 0
