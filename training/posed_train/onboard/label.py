"""`posed-train label`: boxes drawn in a few photos become boxes, masks and poses in all of a scene's."""

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from ..bop import DatasetError, image_path, read_json, stated_pose
from ..midway import change, contrast
from ..rays import upwards
from . import project as projects
from .coverage import draw_sheet, thumbnail
from .drawn import BAD, parse, read_file
from .labels import Entry, write_entries
from .outlines import Label, Shape, find_shape, fit_solid, label_photo, measure
from .project import Item, Project, replace_text
from .scene import photo_names
from .solid import Frame, Solid

DRAWN = "drawn.json"
UNLIKE = 0.75
"""IoU of the masks' boxes with the drawn ones."""
STANDING_FROM_BOARD = np.diag([1.0, -1.0, -1.0, 1.0])
"""z up: a board's z points into it."""
COLOURS = ((60, 220, 60), (255, 140, 40), (60, 60, 255), (220, 60, 220), (40, 220, 220), (255, 255, 80))


@dataclass(frozen=True)
class Scene:
    """A scene of a project in the frame in which things stand."""

    folder: Path
    frames: list[Frame]
    grounded: bool
    """Things stand on z = 0."""
    standing_from_world: np.ndarray


def read_scene(folder: Path, source: dict) -> Scene:
    cameras, names = read_json(folder / "scene_camera.json"), photo_names(folder)
    poses = {}
    for key, entry in cameras.items():
        poses[key] = stated_pose(entry, "w2c")
        if poses[key] is None:
            raise DatasetError(f"{folder / 'scene_camera.json'}: image {key} has no cam_R_w2c and cam_t_w2c")
    grounded = source.get("by") == "board"
    standing_from_world = STANDING_FROM_BOARD if grounded else upright(list(poses.values()), source.get("up"))
    world_from_standing = np.linalg.inv(standing_from_world)
    frames = []
    for key in sorted(cameras, key=int):
        path = image_path(folder, int(key))
        with Image.open(path) as image:
            width, height = image.size
        matrix = np.array(cameras[key]["cam_K"], float).reshape(3, 3)
        name = names.get(int(key), path.name)
        frames.append(Frame(int(key), name, path, width, height, matrix, poses[key] @ world_from_standing))
    return Scene(folder, frames, grounded, standing_from_world)


def upright(poses: list[np.ndarray], up: list[float] | None) -> np.ndarray:
    """`standing_from_world` of a world whose up is told, or else is what photos have upwards in the mean."""
    z = np.array(up, float) if up else upwards(np.stack(poses))
    if not np.linalg.norm(z) > 1e-6:
        raise DatasetError("the photos do not tell where up is: give `up = [x, y, z]` under [[photos]] in object.toml")
    z /= np.linalg.norm(z)
    x = np.cross([0, 1.0, 0] if abs(z[1]) < 0.9 else [1.0, 0, 0], z)
    x /= np.linalg.norm(x)
    turn = np.eye(4)
    turn[:3, :3] = np.stack([x, np.cross(z, x), z])
    return turn


def read_image(frame: Frame) -> np.ndarray:
    image = cv2.imread(str(frame.path), cv2.IMREAD_COLOR)
    if image is None:
        raise DatasetError(f"{frame.path}: not a readable image")
    return image


def label(folder: Path, drawn_file: Path) -> str:
    """Labels each scene whose photos the file names; returns what to print."""
    project = projects.load(folder)
    scenes = {path.name: read_scene(path, source_of(project, path.name)) for path in project.scenes}
    photos = {name: {frame.name for frame in scene.frames} for name, scene in scenes.items()}
    values = read_file(drawn_file)
    drawn = parse(values, drawn_file, project, set().union(*photos.values()))
    texts = []
    for name, scene in scenes.items():
        mine = [item for item, one in drawn.items() if one.is_of(name, photos[name], alone=len(scenes) == 1)]
        given = {item: values[item] for item in mine}
        if BAD in values:
            given[BAD] = [photo for photo in values[BAD] if photo in photos[name]]
        if mine or given.get(BAD):
            texts.append(label_scene(project, scene, given))
    if not texts:
        raise DatasetError(
            f"{drawn_file}: the photos of an object must be of one scene, and a 3D box must name it (scene); there are "
            f"{', '.join(scenes)}"
        )
    return "\n".join(texts)


def source_of(project: Project, scene: str) -> dict:
    return next((source for source in project.sources if source.get("scene") == scene), {})


def label_scene(project: Project, scene: Scene, values: dict) -> str:
    """With what was drawn of other objects before: they can be added one by one."""
    kept = scene.folder / DRAWN
    values = (read_file(kept) if kept.exists() else {}) | values
    bad = {frame.image_id for frame in scene.frames if frame.name in values.get(BAD, [])}
    drawn = parse(values, kept, project, {frame.name for frame in scene.frames})
    items = [item for item in project.items if item.name in drawn]
    shapes = []
    for item in items:
        solid = fit_solid(drawn[item.name], scene.frames, scene.grounded, item.name)
        shapes.append(find_shape(drawn[item.name], solid, scene.frames, read_image))
    labels = label_all(scene.frames, shapes)
    solids = [
        drawn[item.name].solid or measure(shape, scene.frames, [row[k] for row in labels], scene.grounded)
        for k, (item, shape) in enumerate(zip(items, shapes))
    ]
    for item, solid in zip(items, solids):
        one = drawn[item.name]
        item.up, item.symmetries = one.up or item.up, item.symmetries if one.symmetries is None else one.symmetries
        solid.describe(item)
    # Its frame is that of its box in the first scene: elsewhere nothing tells which of the box's sides is which.
    rows = entries(scene, items, solids, labels, with_poses=scene.folder == project.scenes[0])
    write_entries(scene.folder, rows, of={item.obj_id for item in items}, bad=bad)
    replace_text(kept, json.dumps(values, indent=1))
    project.save()
    draw_labels(scene.frames, labels, project.folder / "pictures" / f"labels-{scene.folder.name}.jpg")
    texts = []
    for k, (item, shape, solid) in enumerate(zip(items, shapes, solids)):
        mine = [row[k] for row in labels]
        texts.append(describe(item.name, shape, solid, mine))
        texts += moved(scene.frames, mine)
    return "\n".join(texts)


def moved(frames: Sequence[Frame], labels: Sequence[Label]) -> list[str]:
    """If the object is where it should be up to some photo only, or from there on."""
    told = [(frame, one.contrast) for frame, one in zip(frames, labels) if one.contrast is not None]
    k = change(np.array([value for _, value in told]))
    if k is None:
        return []
    last, first = told[k - 1][0].name, told[k][0].name
    return [
        f"  it was moved after {last}: on one side of that photo the outlines show what it lay on. Take the photos up "
        f"to there (`posed-train new --to {last}`), and give the others by `add --from {first}`"
    ]


def label_all(frames: Sequence[Frame], shapes: Sequence[Shape]) -> list[list[Label]]:
    def one(frame: Frame) -> list[Label]:
        image = read_image(frame)
        labels = label_photo(frame, image, shapes)
        every = np.maximum.reduce([label.mask for label in labels])
        return [replace(label, contrast=contrast(image, label.mask, every & ~label.mask)) for label in labels]

    with ThreadPoolExecutor() as pool:
        return list(pool.map(one, frames))


def entries(
    scene: Scene, items: Sequence[Item], solids: Sequence[Solid], labels: list[list[Label]], with_poses: bool
) -> dict[int, list[Entry]]:
    rows = {}
    for frame, row in zip(scene.frames, labels):
        poses = [
            frame.camera_from_standing @ solid.standing_from_object(item) if with_poses else None
            for item, solid in zip(items, solids)
        ]
        rows[frame.image_id] = [
            Entry(item.obj_id, one.box, one.visible, one.mask, pose) for item, one, pose in zip(items, row, poses)
        ]
    return rows


def draw_labels(frames: Sequence[Frame], labels: list[list[Label]], path: Path) -> None:
    """Outlines and boxes of all photos, small, to be looked over in a minute."""

    def one(pair: tuple[Frame, list[Label]]) -> np.ndarray:
        frame, row = pair
        image = read_image(frame)
        thickness = max(1, frame.width // 320)
        for k, label_ in enumerate(row):
            outlines, _ = cv2.findContours(label_.mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(image, outlines, -1, COLOURS[k % len(COLOURS)], thickness)
        doubtful = any(label_.visible > 0.5 and label_.agreement < 0.8 for label_ in row)
        return thumbnail(image, frame.name, doubtful)

    path.parent.mkdir(exist_ok=True)
    with ThreadPoolExecutor() as pool:
        draw_sheet(list(pool.map(one, zip(frames, labels))), path)


def describe(name: str, shape: Shape, solid: Solid, labels: list[Label]) -> str:
    seen = [one for one in labels if one.visible > 0.1]
    whole = sum(one.visible > 0.95 for one in labels)
    way = "outline of the solid" if shape.hull is None else "visual hull"
    size = " x ".join(f"{1000 * side:.1f}" for side in solid.size)
    lines = [
        f"{name}: {size} mm ({solid.kind}; length, width, height); seen in {len(seen)} photos, whole in {whole}; "
        f"masks by the {way}, their boxes agree with the drawn ones to {shape.agreement:.0%}"
    ]
    if shape.agreement < UNLIKE:
        lines.append("  no upright thing fits the drawn boxes well: is one of them of another object, or was it moved?")
    poor = sum(one.visible > 0.5 and one.agreement < 0.8 for one in labels)
    if poor:
        lines.append(f"  in {poor} photos the colours tell another outline than expected: look at them in the sheet")
    return "\n".join(lines)
