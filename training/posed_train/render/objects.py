"""The meshes to render: a BOP models folder whose vertices are coloured."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

MIN_RESTING_PROBABILITY = 0.02


@dataclass(frozen=True)
class Part:
    """Faces of one colour."""

    faces: np.ndarray  # indices
    colour: np.ndarray  # [3] sRGB, 0..1
    metallic: float  # 0 (plastic, paint) to 1 (bare metal)


@dataclass(frozen=True)
class ObjectMesh:
    obj_id: int
    mesh: trimesh.Trimesh  # metres
    parts: list[Part]
    resting_rotations: np.ndarray  # [n, 3, 3]: how it lies on a table
    resting_probabilities: np.ndarray  # [n]


def load_objects(models: Path) -> list[ObjectMesh]:
    """Reads every `obj_NNNNNN.ply` (millimetres, coloured vertices) and, if there is one, `metallic.json`: how metallic
    their parts are, by object and colour (`#rrggbb`)."""
    described = models / "metallic.json"
    metallic = json.loads(described.read_text()) if described.exists() else {}
    objects = []
    for path in sorted(models.glob("obj_*.ply")):
        obj_id = int(path.stem.split("_")[1])
        mesh = trimesh.load(path, process=False)
        mesh.apply_scale(0.001)
        hull = mesh.convex_hull
        resting, probability = hull.compute_stable_poses(
            center_mass=hull.center_mass, sigma=0.0, n_samples=1, threshold=MIN_RESTING_PROBABILITY
        )
        # The square root: rare sides are seen more often than gravity would show them.
        weight = np.sqrt(probability)
        parts = parts_by_colour(mesh, metallic.get(str(obj_id), {}))
        objects.append(ObjectMesh(obj_id, mesh, parts, resting[:, :3, :3], weight / weight.sum()))
    if not objects:
        raise ValueError(f"{models}: no obj_*.ply files")
    return objects


def choose_objects(objects: list[ObjectMesh], obj_ids: list[int] | None, copies: int) -> list[ObjectMesh]:
    """Those of the given `obj_ids`, or all, each as often as told."""
    if copies < 1:
        raise ValueError(f"copies {copies}: must be at least 1")
    unknown = set(obj_ids or []) - {item.obj_id for item in objects}
    if unknown:
        known = ", ".join(str(item.obj_id) for item in objects)
        raise ValueError(f"object {min(unknown)}: not among the models, which have {known}")
    chosen = [item for item in objects if obj_ids is None or item.obj_id in obj_ids]
    return [item for item in chosen for _ in range(copies)]


def parts_by_colour(mesh: trimesh.Trimesh, metallic: dict[str, float]) -> list[Part]:
    colours = mesh.visual.face_colors[:, :3]
    palette, part = np.unique(colours, axis=0, return_inverse=True)
    unknown = set(metallic) - {hexadecimal(colour) for colour in palette}
    if unknown:
        raise ValueError(f"metallic.json: the mesh has no colour {sorted(unknown)[0]}")
    return [
        Part(np.flatnonzero(part.ravel() == k), colour / 255, metallic.get(hexadecimal(colour), 0.0))
        for k, colour in enumerate(palette)
    ]


def hexadecimal(colour: np.ndarray) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)
