"""A BOP folder with camera poses becomes a project, its labels included."""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ..bop import DatasetError, image_path, read_json, stated_pose
from .camera import Camera
from .photos import DEFAULT_MAX_PX, open_photo
from .posed_photos import Posed, open_all
from .scene import Shot


@dataclass(frozen=True)
class BopScene:
    folder: Path
    keys: list[str]  # of the images, in the order of the shots
    shots: list[Shot]
    obj_ids: list[int]


def read_bop(folder: Path) -> list[BopScene]:
    """Of a split, or of one scene."""
    folders = [folder] if (folder / "scene_camera.json").exists() else sorted(folder.glob("*/scene_camera.json"))
    if not folders:
        raise DatasetError(f"{folder}: no BOP scene (scene_camera.json) there or one level below")
    return [read_scene(path if path.is_dir() else path.parent) for path in folders]


def read_scene(folder: Path) -> BopScene:
    cameras = read_json(folder / "scene_camera.json")
    keys, posed = sorted(cameras, key=int), []
    for key in keys:
        path = image_path(folder, int(key))
        matrix, pose = cameras[key].get("cam_K"), stated_pose(cameras[key], "w2c")
        if not isinstance(matrix, list) or len(matrix) != 9 or pose is None:
            raise DatasetError(f"{folder}: image {key} has no cam_K, cam_R_w2c and cam_t_w2c in scene_camera.json")
        photo = open_photo(path, DEFAULT_MAX_PX * 100)
        camera = Camera(photo.width, photo.height, np.array(matrix, float).reshape(3, 3))
        posed.append(Posed(path.name, path, camera, pose))
    gt = read_json(folder / "scene_gt.json") if (folder / "scene_gt.json").exists() else {}
    ids = sorted({entry["obj_id"] for row in gt.values() for entry in row if "obj_id" in entry})
    return BopScene(folder, keys, open_all(posed, 1.0, DEFAULT_MAX_PX * 100), ids)


def copy_labels(scene: BopScene, out: Path, new_ids: dict[int, int]) -> None:
    """Poses, boxes and masks of the objects that get a new number; images are numbered from 0."""
    if not (scene.folder / "scene_gt_info.json").exists() or not scene.obj_ids:
        return
    gt, info = (read_json(scene.folder / f"scene_{name}.json") for name in ("gt", "gt_info"))
    (out / "mask_visib").mkdir(exist_ok=True)
    poses: dict[str, list] = {}
    infos: dict[str, list] = {}
    for number, key in enumerate(scene.keys):
        poses[str(number)], infos[str(number)] = [], []
        for index, (pose, seen) in enumerate(zip(gt.get(key, []), info.get(key, []))):
            if pose.get("obj_id") not in new_ids:
                continue
            mask = cv2.imread(str(scene.folder / f"mask_visib/{int(key):06d}_{index:06d}.png"), cv2.IMREAD_GRAYSCALE)
            if mask is not None:
                cv2.imwrite(str(out / f"mask_visib/{number:06d}_{len(poses[str(number)]):06d}.png"), mask)
            poses[str(number)].append(pose | {"obj_id": new_ids[pose["obj_id"]]})
            infos[str(number)].append(seen)
    (out / "scene_gt.json").write_text(json.dumps(poses))
    (out / "scene_gt_info.json").write_text(json.dumps(infos))
