"""Camera poses from rendered photos of a board, through the command."""

import json
import shutil

import cv2
import numpy as np
import pytest
from conftest import OBJECTS_ON_BOARD, TAG_MM
from PIL import Image

from benches.poses import differences, scene_poses
from posed_train import bop, cli
from posed_train.onboard import from_board, tags
from posed_train.render.layout import CAMERA_MATRIX, HEIGHT, WIDTH


@pytest.fixture
def new(tmp_path, monkeypatch, capsys):
    """Runs `new` on a folder; gives the scene and what was printed."""

    def run(source, *options, tag_mm=TAG_MM):
        project = tmp_path / "cube"
        words = ["new", project, source, "--tag-mm", tag_mm, *options]
        monkeypatch.setattr("sys.argv", ["posed-train", *map(str, words)])
        try:
            cli.main()
        finally:
            # Whole, or not there at all.
            assert not project.exists() or (project / "object.toml").exists()
            assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]
        return project / "train/000000", capsys.readouterr().out

    return run


def compare(scene, photos, names=None):
    found = scene_poses(scene)
    names = names or photos.names
    return differences(
        [found[name] for name in names], [photos.camera_from_world[photos.names.index(n)] for n in names]
    )


def cameras(scene):
    return json.loads((scene / "scene_camera.json").read_text())


def edit(photos, folder, change):
    """A copy of the photos, each changed by `change(number, image)`; None leaves it out."""
    folder.mkdir()
    for number, name in enumerate(photos.names):
        image = change(number, cv2.imread(str(photos.folder / name)))
        if image is not None:
            cv2.imwrite(str(folder / name), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return folder


def test_photos_of_a_board_tell_poses_and_camera(board_photos, new):
    scene, printed = new(board_photos.folder, "--objects", *OBJECTS_ON_BOARD)
    degrees, millimetres, scale = compare(scene, board_photos)
    assert np.median(degrees) < 0.05 and degrees.max() < 0.2
    assert np.median(millimetres) < 0.5 and millimetres.max() < 1.5
    assert abs(scale - 1) < 0.005
    matrix = np.array(cameras(scene)["0"]["cam_K"]).reshape(3, 3)
    assert abs(matrix[0, 0] / CAMERA_MATRIX[0, 0] - 1) < 0.005 and abs(matrix[1, 1] / CAMERA_MATRIX[1, 1] - 1) < 0.005
    assert np.abs(matrix[:2, 2] - CAMERA_MATRIX[:2, 2]).max() < 3
    assert "no doubtful photos" in printed and "30 photos" in printed and "--span-mm" in printed
    project = scene.parents[1]
    assert (project / "pictures/photos-000000.jpg").stat().st_size > 10_000
    assert (project / "pictures/coverage-000000.png").stat().st_size > 10_000
    camera = json.loads((project / "camera.json").read_text())
    assert camera["model"] == "pinhole" and (camera["width"], camera["height"]) == (WIDTH, HEIGHT)
    assert 'name = "motor"' in (project / "object.toml").read_text()


def test_a_lens_is_found_and_taken_out(board_photos, tmp_path, new):
    lens = np.array([-0.12, 0.05, 0, 0, 0])
    grid = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1).reshape(-1, 1, 2).astype(np.float64)
    straight = (
        cv2.undistortPoints(grid, CAMERA_MATRIX, lens, P=CAMERA_MATRIX).reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    )
    bend = lambda _, image: cv2.remap(image, straight[..., 0], straight[..., 1], cv2.INTER_CUBIC)  # noqa: E731
    scene, printed = new(edit(board_photos, tmp_path / "bent", bend))
    assert "distortion [" in printed
    degrees, millimetres, _ = compare(scene, board_photos)
    assert np.median(degrees) < 0.08 and np.median(millimetres) < 0.8
    camera = json.loads((scene.parents[1] / "camera.json").read_text())
    assert abs(camera["distortion"][0] + 0.12) < 0.02
    # The images that were written are a pinhole camera's: their tags lie where those of the photos without a lens do.
    names = json.loads((scene / "photos.json").read_text())
    moved = []
    for key in ("0", "7", "14"):
        ours = tags.find_tags(cv2.imread(str(scene / f"rgb/{int(key):06d}.jpg"), 0))
        true = tags.find_tags(cv2.imread(str(board_photos.folder / names[key]), 0))
        for tag in set(ours.ids) & set(true.ids):
            moved.append(ours.corners[ours.ids == tag] - true.corners[true.ids == tag])
    assert np.median(np.abs(moved)) < 0.6


def test_turned_photos_share_the_camera_and_come_out_upright(board_photos, tmp_path, new):
    folder = tmp_path / "turned"
    folder.mkdir()
    for number, name in enumerate(board_photos.names):
        with Image.open(board_photos.folder / name) as image:
            exif = image.getexif()
            exif[0x0112] = (1, 6, 3, 8)[number % 4]  # the sensor's pixels stay as they are
            image.save(folder / name, exif=exif, quality=95)
    scene, _ = new(folder)
    written = cameras(scene)
    found, truth = [], []
    for key, name in json.loads((scene / "photos.json").read_text()).items():
        number = board_photos.names.index(name)
        shape = cv2.imread(str(scene / f"rgb/{int(key):06d}.jpg")).shape[:2]
        assert shape == ((HEIGHT, WIDTH) if number % 2 == 0 else (WIDTH, HEIGHT))
        pose, matrix = bop.stated_pose(written[key], "w2c"), np.array(written[key]["cam_K"]).reshape(3, 3)
        # Pose and matrix are of the image that was written: the board's tags project onto themselves.
        quarter = np.linalg.matrix_power(
            np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]), (0, 1, 2, 3)[number % 4]
        )
        found.append(np.linalg.inv(quarter) @ pose)
        truth.append(board_photos.camera_from_world[number])
        assert 0.4 < matrix[0, 2] / shape[1] < 0.6 and 0.4 < matrix[1, 2] / shape[0] < 0.6
    degrees, millimetres, _ = differences(found, truth)
    assert degrees.max() < 0.3 and millimetres.max() < 2


def test_a_ruler_sets_the_scale(board_photos, new):
    ids = [0, 23]
    found = tags.find_tags(cv2.imread(str(board_photos.folder / "IMG_0.jpg"), 0))
    assert len(found) > 4
    from posed_train.onboard.printing import rasterise

    on_paper = tags.find_tags(rasterise(board_photos.sheet, 5))
    a, b = (on_paper.corners[on_paper.ids == tag][0].mean(0) / 5 for tag in ids)
    scene, printed = new(board_photos.folder, "--span-mm", *ids, np.linalg.norm(a - b), tag_mm=25.0)
    assert "+4" in printed or "+3" in printed, printed
    assert abs(compare(scene, board_photos)[2] - 1) < 0.002
    shutil.rmtree(scene.parents[1])
    with pytest.raises(SystemExit, match="measure both again"):
        new(board_photos.folder, "--span-mm", *ids, 100)
    with pytest.raises(SystemExit, match="no tag 99"):
        new(board_photos.folder, "--span-mm", 0, 99, 100)


def test_a_video_gives_its_sharp_frames(board_photos, tmp_path, new):
    video = tmp_path / "walk.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"MJPG"), 10, (WIDTH, HEIGHT))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for name in board_photos.names:
        sharp = cv2.imread(str(board_photos.folder / name))
        for frame in (cv2.GaussianBlur(sharp, (0, 0), 2.5), sharp, cv2.GaussianBlur(sharp, (0, 0), 4)):
            writer.write(frame)
    writer.release()
    scene, _ = new(video, "--frames", 30)
    names = json.loads((scene / "photos.json").read_text())
    numbers = [int(name.split("-")[1][:6]) for name in names.values()]
    assert len(numbers) == 30 and all(number % 3 == 1 for number in numbers), "the sharp ones"
    poses = scene_poses(scene)
    degrees, _, _ = differences(
        [poses[name] for name in names.values()], [board_photos.camera_from_world[number // 3] for number in numbers]
    )
    assert np.median(degrees) < 0.2


def test_doubtful_photos_are_named(board_photos, tmp_path, new):
    def spoil(number, image):
        if number == 3:
            return cv2.GaussianBlur(image, (0, 0), 3)
        if number == 7:
            return image[:, ::-1]
        if number == 9:
            return image[::-1, ::-1]
        return np.full_like(image, 90) if number == 5 else image

    folder = edit(board_photos, tmp_path / "some", spoil)
    (folder / "IMG_90.heic").write_bytes(b"not a photo")
    (folder / "IMG_91.jpg").write_bytes(b"not a photo")
    scene, printed = new(folder)
    assert "IMG_3.jpg: blurred" in printed or "IMG_3.jpg: left out" in printed
    assert "IMG_5.jpg: left out: 0 tags" in printed and "IMG_7.jpg: left out: mirrored" in printed
    assert "IMG_9.jpg: upside down against the others" in printed and "IMG_9.jpg" in scene_poses(scene)
    assert "IMG_90.heic: HEIC cannot be read" in printed and "IMG_91.jpg: not a readable image" in printed
    assert "IMG_5.jpg" not in scene_poses(scene)
    shutil.rmtree(scene.parents[1])
    scene, printed = new(folder, "--without", "IMG_3.jpg")
    assert "IMG_3.jpg" not in printed and "IMG_3.jpg" not in scene_poses(scene)


def test_what_cannot_be_used_is_said(board_photos, tmp_path, new):
    blank = edit(board_photos, tmp_path / "blank", lambda n, image: np.full_like(image, 120))
    with pytest.raises(SystemExit, match="0 tags of apriltag-36h11"):
        new(blank)
    with pytest.raises(SystemExit, match="give --family apriltag-36h11"):
        new(board_photos.folder, "--family", "aruco-7x7")
    blurred = edit(board_photos, tmp_path / "blurred", lambda n, image: cv2.GaussianBlur(image, (0, 0), 4))
    with pytest.raises(SystemExit, match=r"0 tags of apriltag-36h11.*the photos are blurred \(sharpness 0\.\d"):
        new(blurred)
    mirrored = edit(board_photos, tmp_path / "mirrored", lambda n, image: image[:, ::-1])
    with pytest.raises(SystemExit, match="mirrored"):
        new(mirrored)
    few = edit(board_photos, tmp_path / "few", lambda n, image: image if n < 5 else None)
    with pytest.raises(SystemExit, match="too few to tell the camera's parameters"):
        new(few)
    sizes = edit(board_photos, tmp_path / "sizes", lambda n, image: image[:400] if n == 4 else image)
    with pytest.raises(SystemExit, match=r"IMG_4\.jpg \(640x400\)"):
        new(sizes)
    heic = tmp_path / "heic"
    heic.mkdir()
    (heic / "a.HEIC").write_bytes(b"x")
    with pytest.raises(SystemExit, match=r"a\.HEIC: HEIC cannot be read"):
        new(heic)
    with pytest.raises(SystemExit, match="no such folder"):
        new(tmp_path / "nowhere")
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(b"x" * 100)
    with pytest.raises(SystemExit, match="not a video"):
        new(broken)
    with pytest.raises(SystemExit, match="another aspect ratio"):
        camera = tmp_path / "camera.json"
        camera.write_text('{"width": 640, "height": 360, "fx": 600, "fy": 600, "cx": 320, "cy": 180}')
        new(board_photos.folder, "--camera", camera)


def test_some_of_the_photos_are_taken(board_photos, new):
    scene, _ = new(board_photos.folder, "--from", "IMG_4.jpg", "--to", "IMG_21.jpg", "--without", "IMG_9.jpg")
    assert set(scene_poses(scene)) == {f"IMG_{k}.jpg" for k in range(4, 22) if k != 9}
    shutil.rmtree(scene.parents[1])
    for words, message in ((("--from", "IMG_77.jpg"), "--from IMG_77.jpg"), (("--to", "x"), "--to x: no photo")):
        with pytest.raises(SystemExit, match=message):
            new(board_photos.folder, *words)
    with pytest.raises(SystemExit, match="no photo is left"):
        new(board_photos.folder, "--from", "IMG_9.jpg", "--to", "IMG_8.jpg")


@pytest.mark.parametrize("first", [8, 14, 21])
def test_tags_that_were_moved_midway_are_two_components(board_photos, new, monkeypatch, first):
    """Half of the board's tags lie 6 mm beside from some photo on."""
    find_all = from_board.find_all

    def moved(photos, family):
        found, sharp = find_all(photos, family)
        for photo, seen in zip(photos, found):
            number = board_photos.names.index(photo.name)
            if number >= first:
                pose = board_photos.camera_from_world[number]
                to_image = CAMERA_MATRIX @ pose[:3, [0, 1, 3]]
                on_board = cv2.perspectiveTransform(seen.corners, np.linalg.inv(to_image))
                on_board[seen.ids > 11] += [0.006, 0.002]
                seen.corners[:] = cv2.perspectiveTransform(on_board, to_image)
        return found, sharp

    monkeypatch.setattr(from_board, "find_all", moved)
    words = rf"from IMG_{first}\.jpg on the tags lie otherwise.*two components.*--to IMG_{first - 1}\.jpg"
    with pytest.raises(SystemExit, match=words):
        new(board_photos.folder)


def test_two_boards_are_two_scenes(board_photos, tmp_path, new):
    """Photos that share no tags with the others do not get poses in their world."""
    from posed_train.onboard.printing import tag_board
    from posed_train.render import photos
    from posed_train.render.objects import choose_objects, load_objects

    folder = edit(board_photos, tmp_path / "both", lambda n, image: image)
    rng = np.random.default_rng(9)
    objects = choose_objects(load_objects(board_models()), [1], 1)
    other = photos.cameras_around(4, rng, (0.33, 0.4))
    places = [photos.stand(objects[0], 0, 0, 0)]
    for k, photo in enumerate(photos.render_photos(objects, places, tag_board("a4", TAG_MM, 100), other, rng)):
        cv2.imwrite(str(folder / f"OTHER_{k}.jpg"), photo.image[..., ::-1])
    scene, printed = new(folder)
    assert "4 photos show tags that never occur together" in printed and "OTHER_0.jpg: left out" in printed
    assert set(scene_poses(scene)) == set(board_photos.names)


def board_models():
    from conftest import MODELS

    return MODELS
