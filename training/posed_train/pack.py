"""Packs what one training needs of a dataset into a small BOP folder, to be sent to the machine that trains.

Every view becomes an image of its patch alone. Cutting and scaling an image is a change of its camera matrix, so the
packed folder is a dataset like any other, with the same relative poses, and `train.toml` needs no change.
"""

import shutil
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from tqdm import tqdm

from .bop import View, pose_entry, read_mask, read_rgb, read_views, write_annotations, write_mask, write_rgb
from .config import KeypointConfig
from .crops import PATCH_PER_INPUT, PATCH_SCALE, Square
from .data import Views, read_backgrounds
from .network import design

UNPLACED_SCALE = 1.5
"""More room where the box is all that is known: it is of the visible part."""


def pack(config: KeypointConfig, data: Path, out: Path) -> int:
    """Returns the bytes written. A folder that exists is not written into."""
    if out.exists():
        raise OSError(f"{out}: exists already; remove it or pack elsewhere")
    input_size = design(config.network).input_size
    scenes = defaultdict(list)
    for view, place in places(config, data):
        scenes[view.image_path.parents[1].relative_to(data)].append((view, place.scaled(PATCH_SCALE)))
    # As many pixels as training will want of them.
    size = round(PATCH_PER_INPUT * input_size)
    for scene, views in tqdm(scenes.items(), desc=config.name, unit="scene"):
        pack_scene(views, config.obj_id, size, out / scene)
    if config.models:
        shutil.copytree(data / config.models, out / config.models)
    if config.backgrounds:
        pack_backgrounds(data / config.backgrounds, input_size, out / config.backgrounds)
    return sum(path.stat().st_size for path in out.rglob("*") if path.is_file())


def places(config: KeypointConfig, data: Path) -> Iterator[tuple[View, Square]]:
    """Where the object is: by its keypoints, or by the box where they are not known."""
    views = Views(config, data)
    for index, view in enumerate(views.all):
        placed = index in views.registration.placed
        yield view, Square.about(views.targets([index])[0, 0]) if placed else Square.around(view.box, UNPLACED_SCALE)
    if config.validation:
        for view in read_views(data / config.validation, config.obj_id, config.min_visible):
            yield view, Square.around(view.box, UNPLACED_SCALE)


def pack_scene(views: list[tuple[View, Square]], obj_id: int, size: int, out: Path) -> None:
    for sub in ("rgb", "mask_visib"):
        (out / sub).mkdir(parents=True)
    cameras, poses, infos = {}, {}, {}
    for number, (view, square) in enumerate(views):
        write_rgb(out / f"rgb/{number:06d}.jpg", square.cut(read_rgb(view.image_path), size))
        mask = read_mask(view)
        if mask is not None:
            write_mask(out / f"mask_visib/{number:06d}_000000.png", square.cut(mask, size))
        key, crop_from_image = str(number), square.crop_from_image(size)
        cameras[key] = {"cam_K": (crop_from_image @ view.camera_matrix).flatten().tolist()}
        if view.camera_from_world is not None:
            cameras[key] |= pose_entry(view.camera_from_world, "w2c")
        poses[key] = [{"obj_id": obj_id}]
        if view.camera_from_object is not None:
            poses[key][0] |= pose_entry(view.camera_from_object, "m2c")
        x, y, w, h = view.box
        box = (np.array([x - square.left, y - square.top, w, h]) * size / square.side).tolist()
        infos[key] = [{"bbox_visib": box, "visib_fract": view.visible_fraction}]
    write_annotations(out, cameras, poses, infos)


def pack_backgrounds(folder: Path, least_px: int, out: Path) -> None:
    out.mkdir(parents=True)
    for number, image in enumerate(read_backgrounds(folder, least_px)):
        write_rgb(out / f"{number:06d}.jpg", image)
