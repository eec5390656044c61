"""Makes half-hidden views of whole ones: two of most, cut off where a side of the photo moves across the object.

Data sets show few objects so; figures on a dozen views say little.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from .bop import DatasetError, View, pose_entry, read_mask, read_rgb, read_views, write_annotations, write_rgb

CUTS_PER_VIEW = 2
KEPT = 0.35, 0.65
"""Share of the object's pixels."""
LEAST_VISIBLE = 0.85
"""Of views to cut: less is hidden already."""
LEAST_SIDE_PX = 16
"""The service takes no smaller images: an object at the border may leave a strip."""


def cut_off(split: Path, out: Path, obj_ids: list[int]) -> int:
    """Writes a BOP split with a scene for each object, in which every image shows one; returns the number of images. A
    folder that exists is not written into. The same views give the same images."""
    if out.exists():
        raise OSError(f"{out}: exists already; remove it or write elsewhere")
    whole = {obj_id: whole_views(split, obj_id) for obj_id in obj_ids}
    return sum(write_scene(out / f"{obj_id:06d}", obj_id, cuts(views)) for obj_id, views in whole.items())


def whole_views(split: Path, obj_id: int) -> list[View]:
    views = read_views(split, obj_id, LEAST_VISIBLE)
    for view in views:
        if view.camera_from_object is None:
            raise DatasetError(f"{view.image_path}: object {obj_id} has no pose in scene_gt.json to evaluate with")
        if view.mask_path is None:
            raise DatasetError(f"{view.image_path}: object {obj_id} has no mask in mask_visib/ to tell where to cut")
    return views


def cuts(views: list[View]) -> Iterator[tuple[View, np.ndarray]]:
    """Each with its image. The camera's principal point moves with the image's corner; poses stay."""
    rng = np.random.default_rng(0)
    for view in tqdm(views, unit="view"):
        image, mask = read_rgb(view.image_path), read_mask(view) > 0
        for _ in range(CUTS_PER_VIEW):
            part = cut(view, image, mask, int(rng.integers(4)), rng.uniform(*KEPT))
            if min(part[1].shape[:2]) >= LEAST_SIDE_PX:
                yield part


def cut(view: View, image: np.ndarray, mask: np.ndarray, side: int, kept: float) -> tuple[View, np.ndarray]:
    """`side` counts right, left, bottom, top: the one that moves."""
    axis, at_start = 1 - side // 2, side % 2 == 1
    edge = int(np.quantile(np.nonzero(mask)[axis], 1 - kept if at_start else kept))
    start, end = (edge, mask.shape[axis]) if at_start else (0, edge + 1)
    window = (slice(None),) * axis + (slice(start, end),)
    camera_matrix = view.camera_matrix.copy()
    camera_matrix[1 - axis, 2] -= start
    box = cv2.boundingRect(mask[window].astype(np.uint8))
    visible = view.visible_fraction * mask[window].sum() / mask.sum()
    return replace(view, camera_matrix=camera_matrix, box=box, visible_fraction=visible), image[window]


def write_scene(scene: Path, obj_id: int, views: Iterator[tuple[View, np.ndarray]]) -> int:
    (scene / "rgb").mkdir(parents=True)
    cameras, poses, infos = {}, {}, {}
    for number, (view, image) in enumerate(views):
        # Without loss: JPEG's noise would be added twice.
        write_rgb(scene / f"rgb/{number:06d}.png", image)
        key = str(number)
        cameras[key] = {"cam_K": view.camera_matrix.flatten().tolist()}
        poses[key] = [{"obj_id": obj_id} | pose_entry(view.camera_from_object, "m2c")]
        infos[key] = [{"bbox_visib": view.box, "visib_fract": view.visible_fraction}]
    write_annotations(scene, cameras, poses, infos)
    return len(cameras)
