"""The labels of a scene: read, and replaced as a whole."""

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ..bop import pose_entry, read_json, write_mask
from .project import replace_text

LEAST_BOX_PX = 8
NOWHERE = {"bbox_visib": [-1, -1, -1, -1], "px_count_visib": 0, "visib_fract": 0.0}


@dataclass(frozen=True)
class Entry:
    """One object in one photo."""

    obj_id: int
    box: Sequence[float]  # x, y, w, h of what is seen
    visible: float
    mask: np.ndarray | None = None  # [H, W] 0 or 255
    pose: np.ndarray | None = None  # camera_from_object, if it is known

    @property
    def info(self) -> dict:
        if min(self.box[2:]) < LEAST_BOX_PX or self.visible <= 0:
            return NOWHERE
        area = {} if self.mask is None else {"px_count_visib": int((self.mask > 0).sum())}
        return {"bbox_visib": [plain(v) for v in self.box], **area, "visib_fract": round(self.visible, 4)}


def plain(value: float) -> int | float:
    return int(value) if float(value).is_integer() else round(float(value), 3)


def write_entries(scene: Path, rows: Mapping[int, Sequence[Entry]], of: set[int], bad: set[int] = frozenset()) -> None:
    """The labels of the objects `of`, by image; those of other objects stay as they are, but in bad photos nothing is
    seen. Masks first, under another name; then they and the annotations take the old ones' place."""
    old_poses, old_infos = (read_json(scene / f"scene_{name}.json") for name in ("gt", "gt_info"))
    masks = scene / "mask_visib.part"
    shutil.rmtree(masks, ignore_errors=True)
    masks.mkdir()
    poses: dict[str, list] = {}
    infos: dict[str, list] = {}
    for key in read_json(scene / "scene_camera.json"):
        poses[key], infos[key] = [], []

        def add(pose: dict, info: dict, key: str = key) -> Path:
            path = masks / f"{int(key):06d}_{len(poses[key]):06d}.png"
            poses[key].append(pose)
            infos[key].append(NOWHERE if int(key) in bad else info)
            return path

        for entry in rows.get(int(key), []):
            stated = {} if entry.pose is None else pose_entry(entry.pose, "m2c")
            path = add({"obj_id": entry.obj_id} | stated, entry.info)
            if entry.mask is not None:
                write_mask(path, entry.mask)
        for index, (pose, info) in enumerate(zip(old_poses.get(key, []), old_infos.get(key, []))):
            if pose.get("obj_id") not in of:
                path, old = add(pose, info), scene / "mask_visib" / f"{int(key):06d}_{index:06d}.png"
                if old.exists():
                    shutil.copyfile(old, path)
    shutil.rmtree(scene / "mask_visib", ignore_errors=True)
    os.replace(masks, scene / "mask_visib")
    replace_text(scene / "scene_gt.json", json.dumps(poses))
    replace_text(scene / "scene_gt_info.json", json.dumps(infos))


def box_of(mask: np.ndarray) -> tuple[int, int, int, int]:
    """x, y, w, h."""
    return cv2.boundingRect(mask)
