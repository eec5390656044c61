"""What the page of `posed-train label` shows, and what it asks for: plain values, no HTTP."""

import json
import threading
from pathlib import Path

import cv2
import numpy as np

from ..bop import DatasetError, read_json, stated_pose
from . import drawn as files
from . import project as projects
from .drawn import BAD, parse
from .label import DRAWN, Scene, label, read_image, read_scene, source_of
from .outlines import Shape, fit_solid, label_photo
from .project import Item, Project, replace_text
from .solid import Frame, Solid, box_from_object

SMALL_PX = 360
"""Longer side of the photos in the sheet."""
SIMPLER = 0.002
"""An outline's corners are left out that change it by less than this share of its length."""
LEAST_AREA_PX = 20


class State:
    """A project whose objects are being labelled, one scene at a time."""

    def __init__(self, folder: Path):
        self.folder = folder
        project = projects.load(folder)
        self.scenes = {path.name: read_scene(path, source_of(project, path.name)) for path in project.scenes}
        if not self.scenes:
            raise DatasetError(f"{folder}: has no photos yet; `posed-train new`")
        self.small: dict[tuple[str, int], bytes] = {}
        self.job = Job()
        self.saving = threading.Lock()

    @property
    def project(self) -> Project:
        """As it is now: it may be edited by hand meanwhile."""
        return projects.load(self.folder)

    def scene(self, name: object) -> Scene:
        if name not in self.scenes:
            raise DatasetError(f"scene {name!r}: there are {', '.join(self.scenes)}")
        return self.scenes[name]

    def file(self, scene: str) -> Path:
        """What the page saves, for `label --box`."""
        return self.folder / f"boxes-{scene}.json"

    def as_dict(self) -> dict:
        project = self.project
        return {
            "name": self.folder.resolve().name,
            "objects": [
                {
                    "name": item.name,
                    "up": item.up,
                    "symmetries": item.symmetries,
                    "solid": item.solid,
                    "size_mm": item.size_mm,
                }
                for item in project.items
            ],
            "scenes": [self.describe(project, scene) for scene in self.scenes.values()],
        }

    def describe(self, project: Project, scene: Scene) -> dict:
        """With what was drawn in it, or else the boxes that it was labelled with."""
        name = scene.folder.name
        saved = next((path for path in (self.file(name), scene.folder / DRAWN) if path.exists()), None)
        values = files.read_file(saved) if saved else {}
        for item in project.items:
            if item.name not in values and (solid := stated_solid(scene, item)) is not None:
                values[item.name] = entry_of(solid, name)
        return {
            "name": name,
            "grounded": scene.grounded,
            "frames": [describe_frame(frame) for frame in scene.frames],
            "drawn": {key: value for key, value in values.items() if key != BAD},
            "bad": values.get(BAD, []),
        }

    def image(self, scene: str, image_id: int, small: bool) -> tuple[bytes, str]:
        """A photo, and its type."""
        frame = self.frame(self.scene(scene), lambda frame: frame.image_id == image_id)
        if not small:
            return frame.path.read_bytes(), "image/png" if frame.path.suffix == ".png" else "image/jpeg"
        key = scene, image_id
        if key not in self.small:
            image = read_image(frame)
            scale = min(1.0, SMALL_PX / max(image.shape[:2]))
            image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            self.small[key] = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
        return self.small[key], "image/jpeg"

    def frame(self, scene: Scene, wanted) -> Frame:
        found = next((frame for frame in scene.frames if wanted(frame)), None)
        if found is None:
            raise DatasetError(f"scene {scene.folder.name} has no such photo")
        return found

    def fit(self, asked: dict) -> dict:
        """The 3D box of boxes drawn in two photos or more."""
        scene, name = self.scene(asked.get("scene")), str(asked.get("object"))
        entry = {key: asked[key] for key in ("boxes", "solid") if asked.get(key) is not None}
        (one,) = self.parse(scene, {name: entry}).values()
        return entry_of(fit_solid(one, scene.frames, scene.grounded, name), scene.folder.name)

    def outline(self, asked: dict) -> dict:
        """Of each object in one photo, as the colours tell it near its 3D box: `[[x, y], ...]` by its name."""
        scene = self.scene(asked.get("scene"))
        frame = self.frame(scene, lambda frame: frame.name == asked.get("photo"))
        found = self.parse(scene, asked.get("objects") or {})
        solids = {name: one.solid for name, one in found.items() if one.solid is not None}
        shapes = [Shape(solid, None, 1.0, 1.0) for solid in solids.values()]
        labels = label_photo(frame, read_image(frame), shapes)
        return {name: outlines(one.mask) for name, one in zip(solids, labels)}

    def parse(self, scene: Scene, values: object) -> dict:
        if not isinstance(values, dict):
            raise DatasetError("objects by their names are needed")
        return parse(values, Path("page"), self.project, {frame.name for frame in scene.frames})

    def save(self, asked: dict) -> dict:
        scene = self.scene(asked.get("scene"))
        values = asked.get("objects")
        if not isinstance(values, dict):
            raise DatasetError("objects by their names are needed")
        values = dict(values) | {BAD: asked.get("bad") or []}
        self.parse(scene, values)
        path = self.file(scene.folder.name)
        with self.saving:
            replace_text(path, json.dumps(values, indent=1, ensure_ascii=False) + "\n")
        return {"file": str(path)}

    def start_labelling(self, asked: dict) -> dict:
        """Saves, and labels all photos; `job` tells how it goes."""
        saved = self.save(asked)
        self.job.start(lambda: label(self.folder, Path(saved["file"])))
        return saved


class Job:
    """One labelling at a time, beside the page."""

    def __init__(self):
        self.lock = threading.Lock()
        self.running, self.text, self.error = False, "", ""

    def start(self, work) -> None:
        with self.lock:
            if self.running:
                raise DatasetError("the photos are being labelled already; wait until that is done")
            self.running, self.text, self.error = True, "", ""
        threading.Thread(target=self.run, args=(work,), daemon=True).start()

    def run(self, work) -> None:
        try:
            text, error = work(), ""
        except (DatasetError, OSError, ValueError) as failure:
            text, error = "", str(failure)
        except Exception as failure:  # the page must hear of it
            text, error = "", f"{type(failure).__name__}: {failure}"
        with self.lock:
            self.running, self.text, self.error = False, text, error

    def as_dict(self) -> dict:
        with self.lock:
            return {"running": self.running, "text": self.text, "error": self.error}


def describe_frame(frame: Frame) -> dict:
    return {
        "id": frame.image_id,
        "name": frame.name,
        "width": frame.width,
        "height": frame.height,
        "matrix": frame.matrix.tolist(),
        "camera_from_standing": frame.camera_from_standing[:3].tolist(),
    }


def entry_of(solid: Solid, scene: str) -> dict:
    """As the file of `label --box` has it."""
    return {
        "solid": solid.kind,
        "base_mm": [round(float(1000 * value), 2) for value in solid.base],
        "yaw_deg": round(float(np.degrees(solid.yaw)), 3),
        "size_mm": [round(float(1000 * side), 2) for side in solid.size],
        "scene": scene,
    }


def stated_solid(scene: Scene, item: Item) -> Solid | None:
    """By the pose of its box in the first photo that states one."""
    path = scene.folder / "scene_gt.json"
    if len(item.size_mm) != 3 or not path.exists():
        return None
    poses = read_json(path)
    for frame in scene.frames:
        for entry in poses.get(str(frame.image_id), []):
            pose = stated_pose(entry, "m2c") if entry.get("obj_id") == item.obj_id else None
            if pose is not None:
                object_from_box = np.linalg.inv(box_from_object(item.up))
                place = np.linalg.inv(frame.camera_from_standing) @ pose @ object_from_box
                size = np.abs(object_from_box[:3, :3]).T @ np.array(item.size_mm) / 1000
                base = place[:3, 3] - [0, 0, size[2] / 2]
                return Solid(item.solid, base, float(np.arctan2(place[1, 0], place[0, 0])), size)
    return None


def outlines(mask: np.ndarray) -> list[list[list[float]]]:
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    large = [outline for outline in found if cv2.contourArea(outline) >= LEAST_AREA_PX]
    simple = [cv2.approxPolyDP(one, SIMPLER * cv2.arcLength(one, True), True)[:, 0] for one in large]
    return [one.tolist() for one in simple]
