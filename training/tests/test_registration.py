"""Components, virtual keypoints and the checks before training, on synthetic views of a ball-shaped object."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from posed_train import check, keypoints, registration
from posed_train.bop import DatasetError, View

K = np.array([[600.0, 0, 319.5], [0, 600.0, 239.5], [0, 0, 1]])
RADIUS_M = 0.05
OBJECT_IN_WORLD = np.array([0.2, -0.1, 0.05])


def looking_at(target: np.ndarray, direction: np.ndarray, distance: float) -> np.ndarray:
    """`camera_from_world` of a camera that sees the target in the middle of its image."""
    z = -direction / np.linalg.norm(direction)
    x = np.cross(z, [0.3, 0.5, 0.81])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z])
    pose[:3, 3] = -pose[:3, :3] @ (target - distance * z)
    return pose


def ball_views(tmp_path: Path, scene: str, count: int, seed: int = 0) -> list[View]:
    """Views of a ball from all over a half sphere, in a scene with a frame of its own."""
    folder = tmp_path / scene / "rgb"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    world_from_object = np.eye(4)
    world_from_object[:3, :3] = registration.random_rotation(seed + 50)
    world_from_object[:3, 3] = OBJECT_IN_WORLD
    views = []
    for number in range(count):
        image = folder / f"{number:06d}.jpg"
        Image.new("RGB", (640, 480)).save(image)
        direction = rng.normal(size=3)
        direction[2] = abs(direction[2])
        distance = rng.uniform(0.4, 0.8)
        pose = looking_at(OBJECT_IN_WORLD, direction, distance)
        side = 2 * RADIUS_M * 600 / distance
        box = (319.5 - side / 2 + 0.5, 239.5 - side / 2 + 0.5, side, side)
        views.append(View("split", scene, number, image, None, K, pose @ world_from_object, pose, box, 1.0))
    return views


def test_camera_poses_alone_place_the_keypoints(tmp_path):
    views = [replace(view, camera_from_object=None) for view in ball_views(tmp_path, "a", 20)]
    placed = registration.register(views, "camera", seed=1)
    for index, view in enumerate(views):
        in_camera = view.camera_from_world[:3, :3] @ OBJECT_IN_WORLD + view.camera_from_world[:3, 3]
        np.testing.assert_allclose(placed.placed[index][:3, 3], in_camera, atol=1e-3)
    assert abs(placed.size_m - 2 * RADIUS_M) < 0.005
    assert np.abs(np.linalg.norm(placed.keypoints, axis=1) - RADIUS_M).max() < 0.005


def test_each_scene_is_a_component_and_the_largest_comes_first(tmp_path):
    views = ball_views(tmp_path, "a", 5) + ball_views(tmp_path, "b", 9, seed=1) + ball_views(tmp_path, "c", 2, seed=2)
    placed = registration.register(views, "camera", seed=1)
    assert [len(component.views) for component in placed.components] == [9, 5, 2]
    assert sorted(placed.placed) == list(range(5, 14))
    assert len(registration.register(views, "object", seed=1).components) == 1


def test_a_net_places_further_components(tmp_path):
    """Every view votes; a component joins when enough votes agree, and wrong votes do not shift it."""
    views = ball_views(tmp_path, "a", 9) + ball_views(tmp_path, "b", 6, seed=1)
    placed = registration.register(views, "camera", seed=1)
    object_from_keypoints = np.linalg.inv(views[0].camera_from_object) @ placed.placed[0]
    votes = {index: views[index].camera_from_object @ object_from_keypoints for index in range(9, 15)}
    spoiled = dict(votes)
    for index in (10, 12):
        spoiled[index] = looking_at(np.zeros(3), np.array([0.3, 0.2, 1.0]), 0.5)
    assert registration.join(placed, {9: votes[9]}) == 0, "one vote is no consensus"
    assert registration.join(placed, {**spoiled, 14: None}) == 0, "half of the votes is not enough"
    assert registration.join(placed, spoiled) == 1
    for index, vote in votes.items():
        np.testing.assert_allclose(placed.placed[index], vote, atol=1e-9)
    assert registration.join(placed, votes) == 0, "it has joined already"


@pytest.mark.parametrize("shape", keypoints.SHAPES)
def test_keypoints_are_spread_and_of_the_right_size(shape):
    points = keypoints.virtual_keypoints(shape, 0.1, 9, seed=4)
    radii = np.linalg.norm(points, axis=1)
    solids = {"tetrahedron": 4, "octahedron": 6, "cube": 8, "icosahedron": 12, "rhombic-dodecahedron": 14}
    assert len(points) == solids.get(shape, 9)
    assert radii.max() < 0.1 + 1e-9 and (shape == "r-volume" or radii.min() > 0.1 - 1e-9)
    assert keypoints.spread(points) > keypoints.MIN_SPREAD
    if shape in keypoints.SOLIDS:
        apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
        nearest = np.sort(apart, axis=1)[:, 1]
        np.testing.assert_allclose(nearest, nearest[0])
        assert keypoints.spread(points) > 0.99
    np.testing.assert_array_equal(points, keypoints.virtual_keypoints(shape, 0.1, 9, seed=4))


def test_keypoints_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="dodecahedron"):
        keypoints.virtual_keypoints("dodecahedron", 0.1, 8, seed=1)
    with pytest.raises(ValueError, match="4 to 16"):
        keypoints.virtual_keypoints("r-sphere", 0.1, 3, seed=1)


def test_the_check_describes_a_good_set(tmp_path):
    report = check.check(ball_views(tmp_path, "a", 80) + ball_views(tmp_path, "b", 10, seed=1), "camera")
    first = report.components[0]
    assert report.views == 90 and first.views == 80
    assert [warning[:8] for warning in report.warnings] == ["no masks"]
    assert abs(first.size_m - 2 * RADIUS_M) < 0.005
    assert 0.4 < first.coverage < 0.7, "a half sphere, and a little of the other half"
    assert first.useful_pairs > 0.95 and first.widest_baseline_deg > 120
    assert "90 views in 2 components" in str(report)


def moved(view: View, change) -> View:
    pose = view.camera_from_world.copy()
    change(pose)
    return replace(view, camera_from_world=pose)


def scaled(factor: float):
    def change(pose):
        pose[:3, 3] *= factor

    return change


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda views: [replace(v, camera_from_world=None) for v in views], "cam_R_w2c"),
        (lambda views: [moved(v, scaled(1e-3)) for v in views], "metres"),
        (lambda views: [moved(v, scaled(1e3)) for v in views], "metres"),
        (lambda views: [replace(v, camera_from_world=np.linalg.inv(v.camera_from_world)) for v in views], "w2c"),
        (lambda views: [replace(v, scene=f"{k}") for k, v in enumerate(views)], "alone in its component"),
        (lambda views: [replace(v, camera_matrix=K * 2) for v in views], "resized"),
        (lambda views: [replace(v, box=(600.0, 10.0, 80.0, 80.0)) for v in views], "outside the image"),
        (lambda views: [views[0], replace(views[0], image_path=views[1].image_path)], "Move the camera"),
        (lambda views: [*views, replace(views[3], box=(10.0, 10.0, 80.0, 80.0))], "more than once"),
        (
            lambda views: views[:6] + [replace(moved(v, scaled(10)), scene="other") for v in views[6:]],
            "mixed units",
        ),
    ],
)
def test_the_check_refuses_what_cannot_work(tmp_path, spoil, words):
    with pytest.raises(DatasetError, match=words):
        check.check(spoil(ball_views(tmp_path, "a", 12)), "camera")


def test_the_check_warns_of_what_works_badly(tmp_path):
    views = ball_views(tmp_path, "a", 12)
    views.append(replace(views[0], scene="alone"))
    views += [replace(views[1], scene="from one direction", image_path=view.image_path) for view in views[:2]]
    text = str(check.check(views, "camera"))
    assert "2 components have one image, or images from one direction" in text and "15 views are few" in text
