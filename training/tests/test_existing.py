"""Boxes and masks of other tools: each format, written of true masks, gives them back."""

import base64
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import OBJECTS_ON_BOARD, box_of, run
from PIL import Image

from posed_train import bop
from posed_train.onboard import project as projects
from posed_train.onboard.camera import Camera
from posed_train.onboard.from_yolo import names_in
from posed_train.onboard.originals import read_originals
from posed_train.onboard.photos import open_photo
from posed_train.onboard.scene import Shot, write_scene

WIDTH, HEIGHT = 640, 480


@pytest.fixture(scope="session")
def unlabelled(labelled, tmp_path_factory) -> Path:
    """The project before it was labelled."""
    folder = tmp_path_factory.mktemp("unlabelled") / "cube"
    shutil.copytree(labelled, folder)
    scene = folder / "train/000000"
    shutil.rmtree(scene / "mask_visib")
    (scene / "drawn.json").unlink()
    for name in ("gt", "gt_info"):
        path = scene / f"scene_{name}.json"
        path.write_text(json.dumps({key: [] for key in json.loads(path.read_text())}))
    project = projects.load(folder)
    for item in project.items:
        item.size_mm = []
    project.save()
    return folder


@pytest.fixture
def project(unlabelled, tmp_path) -> Path:
    return Path(shutil.copytree(unlabelled, tmp_path / "copy"))


def every_mask(photos):
    """Photo, object and mask of all that is seen of something."""
    for name, masks in zip(photos.names, photos.masks):
        for label, mask in zip(OBJECTS_ON_BOARD, masks):
            if min(box_of(mask)[2:]) > 10:
                yield name, label, mask


def polygons(mask) -> list[np.ndarray]:
    """Its outlines, from pixel corner to pixel corner."""
    larger = cv2.resize(mask, None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)
    found, _ = cv2.findContours(larger, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return [(points[:, 0] + 0.5) / 8 for points in found if cv2.contourArea(points) > 64]


def runs(mask) -> list[int]:
    flat = (mask > 0).T.ravel()
    ends = np.flatnonzero(np.diff(flat)) + 1
    counts = np.diff(np.concatenate([[0], ends, [flat.size]])).tolist()
    return [0, *counts] if flat[0] else counts


def compressed(counts) -> str:
    """As the COCO tools write it: five bits a character, the lowest first, sign extended."""
    text = ""
    for k, count in enumerate(counts):
        value = count - counts[k - 2] if k > 2 else count
        while True:
            bits, value = value & 31, value >> 5
            more = value != (-1 if bits & 16 else 0)
            text += chr(bits + (32 if more else 0) + 48)
            if not more:
                break
    return text


def coco(photos, annotate, names=OBJECTS_ON_BOARD, size=(WIDTH, HEIGHT)) -> dict:
    images = [
        {"id": 7 + k, "file_name": f"images/{n}", "width": size[0], "height": size[1]}
        for k, n in enumerate(photos.names)
    ]
    annotations = [
        {
            "id": k,
            "image_id": 7 + photos.names.index(name),
            "category_id": 3 + OBJECTS_ON_BOARD.index(label),
            **annotate(mask),
        }
        for k, (name, label, mask) in enumerate(every_mask(photos))
    ]
    categories = [{"id": 3 + k, "name": name} for k, name in enumerate(names)]
    return {"images": images, "annotations": annotations, "categories": categories}


def as_outlines(mask):
    return {"segmentation": [outline.ravel().tolist() for outline in polygons(mask)], "bbox": list(box_of(mask))}


def as_runs(mask):
    return {"segmentation": {"size": [HEIGHT, WIDTH], "counts": runs(mask)}, "iscrowd": 0}


def as_compressed(mask):
    return {"segmentation": {"size": [HEIGHT, WIDTH], "counts": compressed(runs(mask))}, "bbox": [0, 0, 1, 1]}


def as_box(mask):
    return {"bbox": list(map(float, box_of(mask)))}


def write_coco(annotate):
    def write(photos, folder):
        (folder / "labels.json").write_text(json.dumps(coco(photos, annotate)))
        return ["--coco", folder / "labels.json"]

    return write


def write_labelme(shapes_of):
    def write(photos, folder):
        by_photo = {}
        for name, label, mask in every_mask(photos):
            by_photo.setdefault(name, []).extend({"label": label, **shape} for shape in shapes_of(mask))
        for name, shapes in by_photo.items():
            values = {"imagePath": f"..\\photos\\{name}", "imageWidth": WIDTH, "imageHeight": HEIGHT, "shapes": shapes}
            (folder / name).with_suffix(".json").write_text(json.dumps(values))
        return ["--labelme", folder]

    return write


def labelme_outlines(mask):
    return [{"points": outline.tolist(), "shape_type": "polygon", "group_id": 1} for outline in polygons(mask)]


def labelme_mask(mask):
    x, y, w, h = box_of(mask)
    content = base64.b64encode(cv2.imencode(".png", mask[y : y + h, x : x + w])[1]).decode()
    return [{"points": [[x, y], [x + w - 1, y + h - 1]], "shape_type": "mask", "mask": content}]


def labelme_box(mask):
    x, y, w, h = box_of(mask)
    return [{"points": [[x + w, y], [x, y + h]], "shape_type": "rectangle"}]


def write_yolo(numbers_of):
    def write(photos, folder):
        (folder / "labels").mkdir()
        (folder / "data.yaml").write_text("# made by hand\nnames:\n  0: 'cube'\n  1: motor  # with a shaft\nnc: 2\n")
        for name, label, mask in every_mask(photos):
            with (folder / "labels" / name).with_suffix(".txt").open("a") as file:
                file.write(f"{OBJECTS_ON_BOARD.index(label)} " + " ".join(f"{v:.6f}" for v in numbers_of(mask)) + "\n")
        return ["--yolo", folder / "labels"]

    return write


def yolo_box(mask):
    x, y, w, h = box_of(mask)
    return (x + w / 2) / WIDTH, (y + h / 2) / HEIGHT, w / WIDTH, h / HEIGHT


def yolo_outline(mask):
    return (max(polygons(mask), key=len) / [WIDTH, HEIGHT]).ravel()


def write_masks(photos, folder):
    for name, label, mask in every_mask(photos):
        (folder / label).mkdir(exist_ok=True)
        cv2.imwrite(str((folder / label / name).with_suffix(".png")), mask // 255)
    return ["--masks", folder]


EXACT, FINE, BOXES = 1.0, 0.97, None
FORMATS = {
    "COCO outlines": (write_coco(as_outlines), FINE),
    "COCO run lengths": (write_coco(as_runs), EXACT),
    "COCO compressed": (write_coco(as_compressed), EXACT),
    "COCO boxes": (write_coco(as_box), BOXES),
    "labelme outlines": (write_labelme(labelme_outlines), FINE),
    "labelme masks": (write_labelme(labelme_mask), EXACT),
    "labelme boxes": (write_labelme(labelme_box), BOXES),
    "YOLO boxes": (write_yolo(yolo_box), BOXES),
    "YOLO outlines": (write_yolo(yolo_outline), FINE),
    "PNG masks": (write_masks, EXACT),
}


def overlap(a, b):
    return (a & b).sum() / max(1, (a | b).sum())


@pytest.mark.parametrize("name", FORMATS)
def test_labels_come_back(project, board_photos, tmp_path, capsys, name):
    write, expected = FORMATS[name]
    folder = tmp_path / "labels"
    folder.mkdir()
    run("label", project, *write(board_photos, folder))
    printed = capsys.readouterr().out
    scene = project / "train/000000"
    numbers = {photo: int(key) for key, photo in json.loads((scene / "photos.json").read_text()).items()}
    for obj_id, label in enumerate(OBJECTS_ON_BOARD, 1):
        views = {view.image_id: view for view in bop.read_views(project / "train", obj_id, min_box_px=8)}
        masks, count = [], 0
        for photo, other, true in every_mask(board_photos):
            if other != label:
                continue
            count += 1
            view = views[numbers[photo]]
            assert np.abs(np.array(view.box) - box_of(true)).max() <= (0 if expected in (EXACT, BOXES) else 1), photo
            mask = bop.read_mask(view)
            if mask is not None:
                masks.append(overlap(mask > 0, true > 0))
        assert f"{label}: labels in {count} of 30 photos" in printed
        if expected is not None:
            assert len(masks) == count and min(masks) >= expected
        else:  # found by the colours
            assert len(masks) > 0.8 * count and np.median(masks) > 0.9
    # The boxes tell the object's frame and size.
    cube = projects.load(project).item("cube")
    assert np.allclose(cube.size_mm, 54.2, atol=3)
    (first, *_) = bop.read_views(project / "train", 1)
    assert first.camera_from_object is not None and (project / "pictures/labels-000000.jpg").exists()


def test_one_object_after_the_other(project, board_photos, drawn, tmp_path):
    """Of different tools, and none takes away what was there."""
    (tmp_path / "masks").mkdir()
    write_masks(board_photos, tmp_path / "masks")
    shutil.rmtree(tmp_path / "masks/motor")
    run("label", project, "--masks", tmp_path / "masks")
    before = [(view.box, bop.read_mask(view)) for view in bop.read_views(project / "train", 1)]
    (tmp_path / "boxes.json").write_text(json.dumps({"motor": drawn["motor"], "bad photos": [board_photos.names[3]]}))
    run("label", project, "--box", tmp_path / "boxes.json")
    after = {view.image_id: view for view in bop.read_views(project / "train", 1)}
    assert len(after) == len(before) - 1, "but for the bad photo"
    assert len(bop.read_views(project / "train", 2, min_visible=0.5)) > 20
    for view, (box, mask) in zip(after.values(), [one for k, one in enumerate(before) if k in after]):
        assert view.box == box and (bop.read_mask(view) == mask).all()


def test_photos_are_found_by_the_projects_own_names_too(project, board_photos, tmp_path):
    values = coco(board_photos, as_runs)
    numbers = {photo: int(key) for key, photo in json.loads((project / "train/000000/photos.json").read_text()).items()}
    for image in values["images"]:
        image["file_name"] = f"train/000000/rgb/{numbers[Path(image['file_name']).name]:06d}.jpg"
    (tmp_path / "labels.json").write_text(json.dumps(values))
    run("label", project, "--coco", tmp_path / "labels.json")
    (view,) = [view for view in bop.read_views(project / "train", 1) if view.image_id == numbers[board_photos.names[4]]]
    assert (bop.read_mask(view) == board_photos.masks[4][0]).all()


@pytest.mark.parametrize("orientation", range(1, 9))
def test_what_was_drawn_into_a_photo_is_carried_into_the_projects_image(tmp_path, orientation):
    """However the photo is held, through its lens, and at another size."""
    stored = np.zeros((300, 400, 3), np.uint8)
    cv2.circle(stored, (290, 90), 30, (255, 255, 255), -1, cv2.LINE_AA)
    path = tmp_path / "IMG_1.png"
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(stored).save(path, exif=exif)
    photo = open_photo(path, max_px=200)
    matrix = np.array([[180.0, 0, photo.width / 2], [0, 180, photo.height / 2], [0, 0, 1]])
    camera = Camera(photo.width, photo.height, matrix, np.array([-0.25, 0.1, 0, 0, 0]))
    write_scene([Shot(photo, camera, np.eye(4))], tmp_path / "scene")
    seen = cv2.imread(str(tmp_path / "scene/rgb/000000.jpg"), cv2.IMREAD_GRAYSCALE) > 127
    original = read_originals(tmp_path / "scene")[0]
    upright = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)  # which turns it as EXIF says
    assert original.upright_size == upright.shape[::-1]
    for image, held in ((stored[..., 0], False), (upright, True)):
        assert overlap(original.mask((image > 127) * np.uint8(255), held) > 0, seen) > 0.95
        rows, columns = np.nonzero(image > 127)
        middle = original.points(np.array([[columns.mean(), rows.mean()]]), held)[0]
        rows, columns = np.nonzero(seen)
        assert np.linalg.norm(middle - [columns.mean(), rows.mean()]) < 0.6


def test_names_of_classes_are_read_however_they_are_written(tmp_path):
    path = tmp_path / "data.yaml"
    for text in (
        "names: ['cube', \"motor\"]\n",
        "names:\n- cube\n- motor\nnc: 2\n",
        "nc: 2\nnames:\n  1: motor\n  0: cube\n",
    ):
        path.write_text(f"train: ../train\n{text}")
        assert names_in(path) == {0: "cube", 1: "motor"}


def mirrored(values):
    for one in values["annotations"]:
        one["bbox"][0] = WIDTH - one["bbox"][0] - one["bbox"][2]


def twice(values):
    values["annotations"].append(values["annotations"][0] | {"id": 999})


def renamed(values):
    values["categories"][0]["name"], values["categories"][1]["name"] = "Cube", "thing"


def elsewhere(values):
    for image in values["images"]:
        image["file_name"] = f"other-{Path(image['file_name']).name}"


def resized(values):
    for image in values["images"]:
        image["width"], image["height"] = 1280, 960


def turned(values):
    for image in values["images"]:
        image["width"], image["height"] = HEIGHT, WIDTH


def without_image(values):
    values["annotations"][2]["image_id"] = 4711


def broken_runs(values):
    values["annotations"][2]["segmentation"] = {"size": [HEIGHT, WIDTH], "counts": [3, 4]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (mirrored, "cube: the labels are of mirrored images"),
        (twice, r"IMG_0\.jpg has cube twice"),
        (renamed, r'its categories are Cube, thing: say which is which with --category "Cube=cube"'),
        (elsewhere, r"no image of these labels is in the project: other-IMG_0\.jpg, .* and 25 more"),
        (resized, r"IMG_0\.jpg has 1280x960 px there, the photo has 640x480: .*resized or cropped"),
        (turned, r"has 480x640 px there, the photo has 640x480: .*turned by 90 degrees"),
        (without_image, "annotation 2: no image has the id 4711"),
        (broken_runs, "annotation 2: its run lengths do not fill 640x480 px"),
    ],
)
def test_what_does_not_belong_is_said(project, board_photos, tmp_path, change, message):
    values = coco(board_photos, as_box)
    change(values)
    file = tmp_path / "labels.json"
    file.write_text(json.dumps(values))
    before = files_of(project)
    with pytest.raises(SystemExit, match=message):
        run("label", project, "--coco", file)
    assert files_of(project) == before, "nothing half-written"


def files_of(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_categories_are_told(project, board_photos, tmp_path, capsys):
    values = coco(board_photos, as_runs, names=("Würfel 54", "motor"))
    (tmp_path / "labels.json").write_text(json.dumps(values))
    run("label", project, "--coco", tmp_path / "labels.json")
    assert "the project has no such object: Würfel 54" in capsys.readouterr().out
    run("label", project, "--coco", tmp_path / "labels.json", "--category", "Würfel 54=cube")
    assert len(bop.read_views(project / "train", 1)) > 25
    for told, message in (
        ("cup=cube", "no label has that category"),
        ("motor=cup", "no object 'cup'"),
        ("x", "--category x"),
    ):
        with pytest.raises(SystemExit, match=message):
            run("label", project, "--coco", tmp_path / "labels.json", "--category", told)


def test_files_that_are_no_labels_are_named(project, board_photos, tmp_path):
    def refused(message, *words):
        with pytest.raises(SystemExit, match=message):
            run("label", project, *words)

    file, folder = tmp_path / "x.json", tmp_path / "folder"
    for text in ("{", "[]", '{"images": [], "annotations": [{}], "categories": []}'):
        file.write_text(text)
        refused(r"x\.json: (not valid JSON|a COCO file has images|not a COCO file)", "--coco", file)
    refused("No such file", "--coco", tmp_path / "nowhere")
    for kind in ("--labelme", "--yolo", "--masks"):
        refused("give the folder", kind, tmp_path / "nowhere")
    folder.mkdir()
    refused("no JSON file with labelme's shapes", "--labelme", folder)
    refused(r"no classes\.txt or data\.yaml", "--yolo", folder)
    refused("give each object's masks a folder of its name: cube, motor", "--masks", folder)
    (folder / "classes.txt").write_text("cube\nmotor\n")
    refused("no text file with a label", "--yolo", folder)
    for line, message in (
        ("0 320 240 50 50", "shares of width and height"),
        ("5 0.5 0.5 0.1 0.1", "class 5 has no name"),
        ("0 0.5 0.5 0.1", "four numbers are a box"),
        ("cube 0.5 0.5 0.1 0.1", "not numbers"),
        ("0 0.5 0.5 0 0.1", "width and height above 0"),
    ):
        (folder / "IMG_0.txt").write_text(line)
        refused(rf"IMG_0\.txt: line 1.*{message}", "--yolo", folder)
    shape = {"imagePath": "IMG_0.jpg", "imageWidth": WIDTH, "imageHeight": HEIGHT}
    for shapes, message in (
        ([{"label": "cube", "points": [[1, 1]], "shape_type": "point"}], "a point is no outline"),
        ([{"label": "cube", "points": [[1, 1], [5, 5]], "shape_type": "mask", "mask": "?"}], "not a PNG in base64"),
        ([{"label": "cube"}], "not a file of labelme's"),
    ):
        (folder / "IMG_0.json").write_text(json.dumps(shape | {"shapes": shapes}))
        refused(message, "--labelme", folder)
    (folder / "cube").mkdir()
    refused("no PNG files", "--masks", folder)
    for image, message in (
        (np.full((HEIGHT, WIDTH), 255, np.uint8), "are they inverted"),
        (np.full((HEIGHT, WIDTH, 3), (9, 0, 0), np.uint8), "has colours"),
        (np.repeat(np.arange(3, dtype=np.uint8), HEIGHT * WIDTH // 3).reshape(HEIGHT, WIDTH), "numbers of objects"),
        (np.pad(np.full((9, 9), 255, np.uint8), 50), r"109x109 px there, the photo has 640x480"),
    ):
        cv2.imwrite(str(folder / "cube/IMG_0.png"), image)
        refused(message, "--masks", folder)
