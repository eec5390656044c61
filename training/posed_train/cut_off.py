"""Makes half-hidden views of whole ones: two for each, cut off where a side of the photo moves across the object.

Data sets show few objects so; figures on a dozen views say little.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from .bop import DatasetError, View, pose_entry, read_mask, read_rgb, read_views, write_annotations, write_image

CUTS_PER_VIEW = 2
KEPT = 0.35, 0.65
"""Share of the object's pixels."""
LEAST_VISIBLE = 0.85
"""Of views to cut: less is hidden already."""


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
            yield cut(view, image, mask, int(rng.integers(4)), rng.uniform(*KEPT))


def cut(view: View, image: np.ndarray, mask: np.ndarray, side: int, kept: float) -> tuple[View, np.ndarray]:
    """`side` counts right, left, bottom, top: the one that moves."""
    across, at_start = side < 2, side % 2 == 1
    pixels = np.nonzero(mask)[1 if across else 0]
    edge = int(np.quantile(pixels, 1 - kept if at_start else kept))
    left_over = slice(edge, None) if at_start else slice(edge + 1)
    window = (slice(None), left_over) if across else (left_over, slice(None))
    camera_matrix = view.camera_matrix.copy()
    camera_matrix[0 if across else 1, 2] -= edge if at_start else 0
    seen = mask[window]
    rows, columns = np.nonzero(seen)
    box = (columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1)
    visible = view.visible_fraction * seen.sum() / mask.sum()
    return replace(view, camera_matrix=camera_matrix, box=box, visible_fraction=visible), image[window]


def write_scene(scene: Path, obj_id: int, views: Iterator[tuple[View, np.ndarray]]) -> int:
    (scene / "rgb").mkdir(parents=True)
    cameras, poses, infos = {}, {}, {}
    for number, (view, image) in enumerate(views):
        # Without loss: JPEG's noise would be added twice.
        write_image(scene / f"rgb/{number:06d}.png", np.ascontiguousarray(image[..., ::-1]), [])
        key = str(number)
        cameras[key] = {"cam_K": view.camera_matrix.flatten().tolist()}
        poses[key] = [{"obj_id": obj_id} | pose_entry(view.camera_from_object, "m2c")]
        infos[key] = [{"bbox_visib": [int(value) for value in view.box], "visib_fract": float(view.visible_fraction)}]
    write_annotations(scene, cameras, poses, infos)
    return len(cameras)
