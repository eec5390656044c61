"""Writes novel views as a BOP split, for `novel_views` in `train.toml`."""

import hashlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..agreement import image_sizes
from ..bop import View, pose_entry, write_annotations, write_mask, write_rgb
from ..config import KeypointConfig
from ..crops import PATCH_PER_INPUT
from ..data import Views, read_backgrounds
from ..network import design
from ..residual import whole
from .shape import LEAST_PHOTOS
from .studio import NewView, Photo, Studio

RELIT_SHARE = 0.75
ROOM = 2.6
"""Side of an image by what the object may need: a patch for training fits."""
MIN_PHOTOS = 2 * LEAST_PHOTOS
"""Of a component."""


def make(views: Views, config: KeypointConfig, root: Path, per_photo: int) -> int:
    """Writes views about each photo that is whole and not held out, and returns how many. What was made of the same
    photos is left as it is."""
    out = root / config.novel_views
    size = round(PATCH_PER_INPUT * design(config.network).input_size)
    backgrounds = read_backgrounds(root / config.backgrounds, size) if config.backgrounds else []
    count = 0
    for component in views.registration.components:
        poses = dict(zip(component.views, component.camera_from_component))
        members = usable(views, component.views)
        if len(members) < MIN_PHOTOS:
            continue
        first = views.all[members[0]]
        folder = out / Path(first.split).relative_to(root) / first.scene
        made_of = describe([views.all[index] for index in members], [poses[index] for index in members], per_photo)
        note = folder / "made_of.json"
        if note.exists() and json.loads(note.read_text()) == made_of:
            count += len(list((folder / "rgb").iterdir()))
            continue
        shutil.rmtree(folder, ignore_errors=True)
        studio = Studio([views.all[index] for index in members], np.stack([poses[index] for index in members]))
        component_from_object = None
        if first.camera_from_object is not None:
            component_from_object = np.linalg.inv(poses[members[0]]) @ first.camera_from_object
        rng = np.random.default_rng(config.seed)
        new = [
            one
            for photo in tqdm(studio.photos * per_photo, f"{config.name}: new views", mininterval=5)
            if (one := new_view(studio, photo, size, rng)) is not None
        ]
        write(new, config.obj_id, component_from_object, backgrounds, rng, folder)
        note.write_text(json.dumps(made_of))
        count += len(new)
    return count


def describe(views: Sequence[View], poses: Sequence[np.ndarray], per_photo: int) -> dict[str, str | int]:
    """What new views are made of: others are made where photos, masks or poses change."""
    content = hashlib.sha256()
    for view, pose in zip(views, poses):
        for part in (view.image_path.read_bytes(), view.mask_path.read_bytes(), view.camera_matrix, pose.round(9)):
            content.update(part if isinstance(part, bytes) else np.ascontiguousarray(part).tobytes())
    return {"photos": len(views), "per_photo": per_photo, "sha256": content.hexdigest()}


def usable(views: Views, indices: Sequence[int]) -> list[int]:
    """Of these the photos that show all of the object, have a mask, and are not kept for judging."""
    kept = set(views.held_out)
    chosen = [index for index in indices if index < views.photoreal_count and index not in kept]
    sizes = image_sizes([views.all[index] for index in chosen]) if chosen else []
    return [
        index
        for index, size in zip(chosen, sizes)
        if views.all[index].mask_path is not None and whole(views.all[index], tuple(size))
    ]


def new_view(studio: Studio, photo: Photo, size: int, rng: np.random.Generator) -> NewView | None:
    pose, lit = studio.beside(photo, rng), rng.random() < RELIT_SHARE
    return studio.render(pose, photo.camera_matrix, size, ROOM, rng if lit else None)


def write(
    views: Sequence[NewView],
    obj_id: int,
    component_from_object: np.ndarray | None,
    backgrounds: Sequence[np.ndarray],
    rng: np.random.Generator,
    folder: Path,
) -> None:
    """As a BOP scene, before pieces of photos."""
    for sub in ("rgb", "mask_visib"):
        (folder / sub).mkdir(parents=True)
    cameras, poses, infos = {}, {}, {}
    for number, view in enumerate(views):
        rgb, size = view.rgb, len(view.rgb)
        if backgrounds:
            photo = backgrounds[rng.integers(len(backgrounds))]
            top, left = (rng.integers(side - size + 1) for side in photo.shape[:2])
            weight = view.mask[..., None] / 255
            rgb = (rgb * weight + photo[top : top + size, left : left + size] * (1 - weight)).astype(np.uint8)
        write_rgb(folder / f"rgb/{number:06d}.jpg", rgb)
        write_mask(folder / f"mask_visib/{number:06d}_000000.png", view.mask)
        key = str(number)
        cameras[key] = {"cam_K": view.camera_matrix.flatten().tolist(), **pose_entry(view.camera_from_component, "w2c")}
        poses[key] = [{"obj_id": obj_id}]
        if component_from_object is not None:
            poses[key][0] |= pose_entry(view.camera_from_component @ component_from_object, "m2c")
        infos[key] = [{"bbox_visib": list(view.box), "visib_fract": 1.0}]
    write_annotations(folder, cameras, poses, infos)
