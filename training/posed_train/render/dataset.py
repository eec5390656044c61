"""Writes what an engine shows as a BOP-format folder: millimetres, OpenCV camera frame, pixel centre = integer."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from tqdm import tqdm

from ..bop import pose_entry, write_annotations, write_mask, write_rgb
from .layout import CAMERA_MATRIX, Camera, Camouflage, Layout, draw_layout
from .objects import ObjectMesh
from .path import camera_path, moved

MIN_BOX_PX = 8
FILMS = ("still", "moving")
"""A still scene, and one whose first object moves."""


class Engine(Protocol):
    """Shows one scene at a time."""

    tumbled: float
    """Share of objects that stand at random instead of lying on one of their sides."""

    def open(self, layout: Layout, rng: np.random.Generator) -> None:
        """Builds a scene; materials and brightness are the engine's own to draw."""

    def place(self, world_from_object: list[np.ndarray]) -> None:
        """Moves the objects."""

    def colour(self, camera: Camera) -> np.ndarray:
        """`[H, W, 3]` RGB, 8 bits."""

    def visible(self, camera: Camera) -> np.ndarray:
        """`[H, W]`: 1 + the index of the object seen at each pixel, 0 for anything else."""

    def full_areas(self, camera: Camera) -> list[int]:
        """Pixels of the image that each object would cover if nothing stood before it."""


def render_dataset(
    engine_for: Callable[[list[ObjectMesh], Camouflage], Engine],
    objects: list[ObjectMesh],
    out: Path,
    scenes: int,
    views: int,
    first: int = 0,
    camouflage: float = 0.0,
    film: str | None = None,
) -> None:
    """Renders `scenes` scenes of all objects, `views` images each; finished scenes are kept, so a stopped run goes on.
    `camouflage` is the share of things around the objects that have a colour of one of them. With a `film` (FILMS), the
    images of a scene are those of a camera on its way."""
    if not 0 <= camouflage <= 1:
        raise ValueError(f"camouflage {camouflage}: a share lies between 0 and 1")
    engine = engine_for(objects, Camouflage(objects, camouflage))
    for scene_id in tqdm(range(first, first + scenes), desc="scenes", unit="scene"):
        folder = out / f"{scene_id:06d}"
        if not (folder / "scene_gt_info.json").exists():
            rng = np.random.default_rng([scene_id, 7])
            layout = draw_layout(objects, 0 if film else views, engine.tumbled, rng)
            if film:
                layout = filmed(layout, views, film, rng)
            engine.open(layout, rng)
            write_scene(engine, objects, layout, folder)


def filmed(layout: Layout, views: int, film: str, rng: np.random.Generator) -> Layout:
    cameras = camera_path(layout.world_from_object, views, rng)
    moves = moved(layout.world_from_object[0], views, rng) if film == "moving" else []
    return replace(layout, cameras=cameras, first_moves=moves)


def write_scene(engine: Engine, objects: list[ObjectMesh], layout: Layout, out: Path) -> None:
    for sub in ("rgb", "mask_visib"):
        (out / sub).mkdir(parents=True, exist_ok=True)
    cameras, poses, infos = {}, {}, {}
    for view, camera in enumerate(layout.cameras):
        world_from_object = layout.poses(view)
        engine.place(world_from_object)
        write_rgb(out / f"rgb/{view:06d}.jpg", engine.colour(camera))
        visible, areas = engine.visible(camera), engine.full_areas(camera)
        poses[str(view)], infos[str(view)] = [], []
        for index, item in enumerate(objects):
            mask = (visible == index + 1).astype(np.uint8) * 255
            write_mask(out / f"mask_visib/{view:06d}_{index:06d}.png", mask)
            pose = camera.camera_from_world @ world_from_object[index]
            poses[str(view)].append({"obj_id": item.obj_id} | pose_entry(pose, "m2c"))
            infos[str(view)].append(info_entry(mask, areas[index]))
        cameras[str(view)] = {"cam_K": CAMERA_MATRIX.flatten().tolist()} | pose_entry(camera.camera_from_world, "w2c")
    write_annotations(out, cameras, poses, infos)


def info_entry(mask: np.ndarray, full_area: int) -> dict:
    area = int((mask > 0).sum())
    box = list(cv2.boundingRect(mask)) if area else [-1, -1, -1, -1]
    if min(box[2:]) < MIN_BOX_PX:
        box, area = [-1, -1, -1, -1], 0
    return {
        "bbox_visib": box,
        "px_count_all": full_area,
        "px_count_visib": area,
        "visib_fract": area / max(full_area, 1),
    }
