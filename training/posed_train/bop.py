"""Reads BOP-format folders: https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md

Millimetres on disk become metres here, at the boundary, and nowhere else. Poses are 4x4 `a_from_b` matrices in
the OpenCV camera frame; pixel centres are at integer coordinates.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

METRES_PER_MILLIMETRE = 1e-3
JPEG_QUALITY = 92
MIN_BOX_PX = 16
LEAST_DETERMINANT = 0.1
"""Of what may pass for a rotation: `check` looks closer."""


@dataclass(frozen=True)
class View:
    """One object seen in one image."""

    split: str
    scene: str
    image_id: int
    image_path: Path
    mask_path: Path | None
    camera_matrix: np.ndarray  # [3, 3] pixels
    camera_from_object: np.ndarray | None  # [4, 4] metres, if the dataset states object poses
    camera_from_world: np.ndarray | None  # [4, 4] metres; the scene's own frame, if the dataset states camera poses
    box: tuple[float, float, float, float]  # x, y, w, h of the visible part, pixels
    visible_fraction: float


class DatasetError(ValueError):
    """A dataset folder that cannot be used; the message names the file and the reason."""


def read_json(path: Path) -> dict:
    try:
        content = json.loads(path.read_text())
    except FileNotFoundError:
        raise DatasetError(f"{path}: missing; a BOP scene needs this file") from None
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: not valid JSON ({error})") from None
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: must be a JSON object, {{...}}")
    return content


def read_scene(scene_dir: Path) -> tuple[dict, dict, dict]:
    """What `scene_gt`, `scene_gt_info` and `scene_camera` say, by the image's number."""
    tables = tuple(read_json(scene_dir / f"scene_{name}.json") for name in ("gt", "gt_info", "camera"))
    for name, table, kind in zip(("gt", "gt_info", "camera"), tables, (list, list, dict)):
        for key, entry in table.items():
            where = f"{scene_dir / f'scene_{name}.json'}: image {key}"
            if not (key.isascii() and key.isdigit()):
                raise DatasetError(f"{where}: images are numbers")
            if not isinstance(entry, kind) or (kind is list and not all(isinstance(one, dict) for one in entry)):
                raise DatasetError(f"{where}: must be {'a list of objects, [{...}]' if kind is list else '{...}'}")
    return tables


def numbers(value: object, count: int, where: str) -> np.ndarray:
    """`[count]`, all finite."""
    good = isinstance(value, list) and len(value) == count
    if not good or not all(isinstance(one, int | float) and math.isfinite(one) for one in value):
        raise DatasetError(f"{where} of {count} numbers")
    return np.array(value, float)


def image_path(scene_dir: Path, image_id: int) -> Path:
    for suffix in (".jpg", ".png"):
        path = scene_dir / "rgb" / f"{image_id:06d}{suffix}"
        if path.exists():
            return path
    raise DatasetError(f"{scene_dir}/rgb/{image_id:06d}.jpg: missing, but scene_gt.json names this image")


def read_views(split: Path, obj_id: int, min_visible: float = 0.0, min_box_px: int = MIN_BOX_PX) -> list[View]:
    """All views of one object in a BOP split (a folder of scene folders), in a stable order."""
    views = []
    for scene_dir in scene_folders(split):
        poses, infos, cameras = read_scene(scene_dir)
        for key in sorted(poses, key=int):
            rows = infos.get(key, [])
            if len(rows) != len(poses[key]):
                raise DatasetError(
                    f"{scene_dir}: image {key} has {len(poses[key])} objects in scene_gt.json, {len(rows)} in "
                    "scene_gt_info.json"
                )
            for index, (pose, info) in enumerate(zip(poses[key], rows)):
                if pose.get("obj_id") != obj_id:
                    continue
                view = read_view(scene_dir, int(key), index, pose, info, cameras.get(key))
                if view.visible_fraction >= min_visible and min(view.box[2:]) >= min_box_px:
                    views.append(view)
    if not views:
        raise DatasetError(f"{split}: no usable view of object {obj_id}")
    return views


def scene_folders(split: Path) -> list[Path]:
    """Those that are finished."""
    if not split.is_dir():
        raise DatasetError(f"{split}: no such folder")
    return sorted(p for p in split.iterdir() if (p / "scene_gt_info.json").exists())


def read_view(scene_dir: Path, image_id: int, index: int, pose: dict, info: dict, camera: dict | None) -> View:
    """One entry of `scene_gt.json`; a missing `visib_fract` means that all of the object is seen."""
    where = f"{scene_dir}: image {image_id}"
    if camera is None:
        raise DatasetError(f"{where} is in scene_gt.json, but not in scene_camera.json")
    numbers(info.get("bbox_visib"), 4, f"{where}: scene_gt_info.json has no bbox_visib [x, y, w, h]")
    matrix = numbers(camera.get("cam_K"), 9, f"{where}: scene_camera.json has no cam_K")
    visible = info.get("visib_fract", 1.0)
    if not isinstance(visible, int | float):
        raise DatasetError(f"{where}: scene_gt_info.json has a visib_fract that is no number")
    mask = scene_dir / "mask_visib" / f"{image_id:06d}_{index:06d}.png"
    return View(
        split=str(scene_dir.parent),
        scene=scene_dir.name,
        image_id=image_id,
        image_path=image_path(scene_dir, image_id),
        mask_path=mask if mask.exists() else None,
        camera_matrix=matrix.reshape(3, 3),
        camera_from_object=stated_pose(pose, "m2c", where),
        camera_from_world=stated_pose(camera, "w2c", where),
        box=tuple(info["bbox_visib"]),
        visible_fraction=visible,
    )


def stated_pose(entry: dict, kind: str, where: str = "a pose") -> np.ndarray | None:
    """The pose `cam_R_<kind>`, `cam_t_<kind>` of an entry, if it has one."""
    rotation, translation_mm = entry.get(f"cam_R_{kind}"), entry.get(f"cam_t_{kind}")
    if rotation is None or translation_mm is None:
        return None
    pose = np.eye(4)
    pose[:3, :3] = numbers(rotation, 9, f"{where}: needs a cam_R_{kind}").reshape(3, 3)
    if abs(np.linalg.det(pose[:3, :3])) < LEAST_DETERMINANT:
        raise DatasetError(f"{where}: cam_R_{kind} is no rotation")
    pose[:3, 3] = numbers(translation_mm, 3, f"{where}: needs a cam_t_{kind}") * METRES_PER_MILLIMETRE
    return pose


def pose_entry(pose: np.ndarray, kind: str) -> dict[str, list[float]]:
    """The other way round."""
    translation_mm = pose[:3, 3] / METRES_PER_MILLIMETRE
    return {f"cam_R_{kind}": pose[:3, :3].flatten().tolist(), f"cam_t_{kind}": translation_mm.tolist()}


def read_rgb(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    if image is None:
        raise DatasetError(f"{path}: not a readable image")
    return image


def read_mask(view: View) -> np.ndarray | None:
    return None if view.mask_path is None else cv2.imread(str(view.mask_path), cv2.IMREAD_GRAYSCALE)


def write_rgb(path: Path, image: np.ndarray) -> None:
    write_image(path, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


def write_mask(path: Path, mask: np.ndarray) -> None:
    write_image(path, mask)


def write_image(path: Path, image: np.ndarray) -> None:
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix == ".jpg" else []
    if not cv2.imwrite(str(path), image, options):
        raise OSError(f"{path}: cannot write the image; is the disk full?")


def write_annotations(scene: Path, cameras: dict, poses: dict, infos: dict) -> None:
    """`scene_gt_info.json` last: a scene without it is unfinished."""
    for name, content in (("camera", cameras), ("gt", poses), ("gt_info", infos)):
        (scene / f"scene_{name}.json").write_text(json.dumps(content))


def symmetry_motions(declared: list[list[float]]) -> np.ndarray:
    """`[S, 4, 4]` metres, identity first: discrete symmetries as `models_info.json` states them (row-major, mm)."""
    motions = np.array([np.eye(4).ravel(), *declared]).reshape(-1, 4, 4)
    motions[:, :3, 3] *= METRES_PER_MILLIMETRE
    return motions
