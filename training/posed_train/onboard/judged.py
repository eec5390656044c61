"""What an exported net says of the photos that it has not learned from, each against the other photos of its scene."""

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..bop import DatasetError, View, read_views, symmetry_motions
from ..export import predictor, sha256
from ..pnp import Solved, solve, step_between
from ..registration import triangulate_centre
from ..spread import Deviation, deviations
from ..validate import predict_views
from . import result as results
from .checking import MIN_VISIBLE
from .coverage import Coverage, coverage
from .label import source_of, upright
from .new import UP_FROM_BOARD
from .project import Item, Project
from .scene import photo_names

NEES_MEDIAN = 5.35
"""Of true covariances: chi-squared with six degrees of freedom."""
NEEDED = {"virtual_keypoints_m", "covariance_scale"}


@dataclass(frozen=True)
class Network:
    """An exported keypoint net."""

    folder: Path
    manifest: dict

    @property
    def keypoints(self) -> np.ndarray:
        return np.array(self.manifest["virtual_keypoints_m"])

    @property
    def heights(self) -> np.ndarray | None:
        look = self.manifest.get("second_look")
        return self.keypoints @ look["up"] if look else None

    @property
    def scale(self) -> np.ndarray:
        return np.array(self.manifest["covariance_scale"])

    @property
    def trusted(self) -> bool:
        """Whether posed corrects its covariances by evidence (`posed-train trust`), which `solve` does not know."""
        return "probability" in self.manifest.get("trust", {})

    @property
    def widened(self) -> dict[str, float] | None:
        """What the service multiplies standard deviations by, where the held-out photos told it, by part."""
        trust = self.manifest.get("trust")
        if self.trusted or trust is None:
            return None
        return {part: float(np.exp(one["constant"])) for part, one in trust["covariance"].items()}

    def solve(self, views: Sequence[View]) -> list[Solved | None]:
        """Without what evidence or held-out photos say of covariances."""
        found = predict_views(predictor(self.folder / "keypoints.onnx", self.heights), list(views))
        return [solve(self.keypoints, one, self.scale) for one in found]


def read_network(folder: Path) -> Network:
    try:
        manifest = json.loads((folder / "object.json").read_text())
        stated, found = manifest["model_sha256"], sha256(folder / "keypoints.onnx")
    except OSError as error:
        raise DatasetError(f"{error.filename}: {error.strerror}; `posed-train train` makes it") from None
    except (ValueError, KeyError, TypeError):
        raise DatasetError(f"{folder / 'object.json'}: not a manifest of posed-train's") from None
    if not set(manifest) >= NEEDED:
        raise DatasetError(f"{folder / 'object.json'}: not a manifest of posed-train's")
    if stated != found:
        raise DatasetError(f"{folder / 'keypoints.onnx'}: its SHA-256 is not the one in object.json; train again")
    return Network(folder, manifest)


@dataclass(frozen=True)
class Judged:
    """One held-out photo."""

    view: View
    name: str
    solved: Solved | None
    deviation: Deviation
    azimuth_deg: float
    elevation_deg: float
    distance_m: float

    @property
    def degrees(self) -> float:
        return self.deviation.degrees

    @property
    def millimetres(self) -> float:
        return self.deviation.millimetres

    @property
    def depth_mm(self) -> float:
        """Along the ray: positive where the photo sees the object farther away than the others do."""
        return 1000 * float(self.step[:3] @ self.ray) if self.deviation.compared else np.inf

    @property
    def lateral_mm(self) -> float:
        if not self.deviation.compared:
            return np.inf
        return 1000 * float(np.linalg.norm(self.step[:3] - self.ray * (self.step[:3] @ self.ray)))

    @property
    def nees(self) -> float:
        """Its deviation's square by its covariance; infinite where there is no pose."""
        if self.solved is None or not self.deviation.compared:
            return np.inf
        return float(self.step @ np.linalg.solve(self.solved.covariance, self.step))

    @property
    def step(self) -> np.ndarray:
        return step_between(self.deviation.expected, self.deviation.found)

    @property
    def ray(self) -> np.ndarray:
        place = self.deviation.expected[:3, 3]
        return place / np.linalg.norm(place)

    @property
    def side_px(self) -> float:
        return float(max(self.view.box[2:]))


@dataclass(frozen=True)
class Judgement:
    """All that is known of an object's net and photos."""

    network: Network
    result: results.Result
    run: Path  # folder of the training
    views: list[View]
    held_out: list[Judged]
    seen: dict[str, Coverage]
    """By scene: from where the object is seen in all its photos, in the order of `views`."""
    names: dict[tuple[str, int], str]
    """The photos', by scene and image."""

    def name(self, view: View) -> str:
        return self.names[view.scene, view.image_id]

    def of_scene(self, scene: str) -> list[View]:
        return [view for view in self.views if view.scene == scene]


def judge(project: Project, item: Item, models: Path) -> Judgement:
    network = read_network(models / item.name)
    result, run = results.find(project, item, network.manifest["model_sha256"], models)
    views = read_views(project.split, item.obj_id, MIN_VISIBLE)
    by_scene: dict[str, list[View]] = defaultdict(list)
    for view in views:
        by_scene[view.scene].append(view)
    seen, names, where = {}, {}, {}
    for scene, members in by_scene.items():
        seen[scene] = look_from(project, scene, members)
        photos = photo_names(project.split / scene)
        for k, view in enumerate(members):
            names[scene, view.image_id] = photos.get(view.image_id, view.image_path.name)
            where[scene, view.image_id] = [getattr(seen[scene], name)[k] for name in ANGLES]
    chosen = [view for view in views if result.is_held_out(view.scene, view.image_id)]
    solved = network.solve(chosen)
    found = deviations(
        [view.scene for view in chosen],
        [view.camera_from_world for view in chosen],
        [one and one.camera_from_keypoints for one in solved],
        motions(network, result),
    )
    held_out = [
        Judged(view, names[view.scene, view.image_id], one, apart, *where[view.scene, view.image_id])
        for view, one, apart in zip(chosen, solved, found)
    ]
    return Judgement(network, result, run, views, held_out, seen, names)


ANGLES = ("azimuth_deg", "elevation_deg", "distance_m")


def motions(network: Network, result: results.Result) -> np.ndarray:
    """Those of the keypoints' frame under which the object looks the same."""
    declared = network.manifest.get("symmetries_discrete", [])
    if not declared or result.keypoints_from_object is None:
        return np.eye(4)[None]
    known = np.array(result.keypoints_from_object)
    return known @ symmetry_motions(declared) @ np.linalg.inv(known)


def look_from(project: Project, scene: str, views: list[View]) -> Coverage:
    """From where a scene's photos see the object."""
    poses = np.stack([view.camera_from_world for view in views])
    source = source_of(project, scene)
    up = UP_FROM_BOARD if source.get("by") == "board" else upright(list(poses), source.get("up"))[2, :3]
    centre = triangulate_centre(views, poses) if len(views) > 1 else poses[0, :3, 2]
    return coverage(poses, centre, up)
