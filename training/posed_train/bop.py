"""Reads BOP-format folders: https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md

Millimetres on disk become metres here, at the boundary, and nowhere else. Poses are 4x4 `a_from_b` matrices in
the OpenCV camera frame; pixel centres are at integer coordinates.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

METRES_PER_MILLIMETRE = 1e-3
JPEG_QUALITY = 92
MIN_BOX_PX = 16


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
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise DatasetError(f"{path}: missing; a BOP scene needs this file") from None
    except json.JSONDecodeError as error:
        raise DatasetError(f"{path}: not valid JSON ({error})") from None


def image_path(scene_dir: Path, image_id: int) -> Path:
    for suffix in (".jpg", ".png"):
        path = scene_dir / "rgb" / f"{image_id:06d}{suffix}"
        if path.exists():
            return path
    raise DatasetError(f"{scene_dir}/rgb/{image_id:06d}.jpg: missing, but scene_gt.json names this image")


def read_views(split: Path, obj_id: int, min_visible: float = 0.0, min_box_px: int = MIN_BOX_PX) -> list[View]:
    """All views of one object in a BOP split (a folder of scene folders), in a stable order."""
    views = []
    for scene_dir in sorted(p for p in split.iterdir() if (p / "scene_gt_info.json").exists()):
        poses, infos, cameras = (read_json(scene_dir / f"scene_{name}.json") for name in ("gt", "gt_info", "camera"))
        for key in sorted(poses, key=int):
            for index, (pose, info) in enumerate(zip(poses[key], infos[key], strict=True)):
                x, y, w, h = info["bbox_visib"]
                if pose["obj_id"] != obj_id or info["visib_fract"] < min_visible or min(w, h) < min_box_px:
                    continue
                mask = scene_dir / "mask_visib" / f"{int(key):06d}_{index:06d}.png"
                views.append(
                    View(
                        split=str(split),
                        scene=scene_dir.name,
                        image_id=int(key),
                        image_path=image_path(scene_dir, int(key)),
                        mask_path=mask if mask.exists() else None,
                        camera_matrix=np.array(cameras[key]["cam_K"]).reshape(3, 3),
                        camera_from_object=stated_pose(pose, "m2c"),
                        camera_from_world=stated_pose(cameras[key], "w2c"),
                        box=(x, y, w, h),
                        visible_fraction=info["visib_fract"],
                    )
                )
    if not views:
        raise DatasetError(f"{split}: no usable view of object {obj_id}")
    return views


def rigid(rotation: list[float], translation_mm: list[float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = np.array(rotation).reshape(3, 3)
    pose[:3, 3] = np.array(translation_mm) * METRES_PER_MILLIMETRE
    return pose


def stated_pose(entry: dict, kind: str) -> np.ndarray | None:
    """The pose `cam_R_<kind>`, `cam_t_<kind>` of an entry, if it has one."""
    rotation, translation = entry.get(f"cam_R_{kind}"), entry.get(f"cam_t_{kind}")
    return None if rotation is None or translation is None else rigid(rotation, translation)


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
