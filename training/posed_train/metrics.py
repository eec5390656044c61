"""Accuracy of poses, as the field defines it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from . import bop


@dataclass(frozen=True)
class Model:
    """What scoring needs of an object's mesh: vertices and diameter in metres, and its symmetries."""

    vertices: np.ndarray
    diameter: float
    symmetric: bool
    motions: np.ndarray  # [S, 4, 4] under which the object looks the same, identity first; discrete ones alone


def load_model(path, info: dict) -> Model:
    import trimesh  # a training without a mesh does without it, on a machine that may not have it

    vertices = np.asarray(trimesh.load(path, process=False).vertices) * 1e-3
    symmetric = bool(info.get("symmetries_discrete") or info.get("symmetries_continuous"))
    motions = bop.symmetry_motions(info.get("symmetries_discrete", []))
    return Model(vertices, info["diameter"] * 1e-3, symmetric, motions)


def transform(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ pose[:3, :3].T + pose[:3, 3]


def add(model: Model, estimate: np.ndarray, truth: np.ndarray) -> float:
    """ADD in metres; ADD-S (closest point) for an object with symmetries."""
    estimated, true = transform(estimate, model.vertices), transform(truth, model.vertices)
    if model.symmetric:
        return float(cKDTree(estimated).query(true)[0].mean())
    return float(np.linalg.norm(estimated - true, axis=1).mean())


def projection_error_px(model: Model, estimate: np.ndarray, truth: np.ndarray, camera_matrix: np.ndarray) -> float:
    """Mean distance of the vertices' projections; of closest ones for an object with symmetries."""

    def pixels(pose: np.ndarray) -> np.ndarray:
        image = transform(pose, model.vertices) @ camera_matrix.T
        return image[:, :2] / image[:, 2:]

    if model.symmetric:
        return float(cKDTree(pixels(estimate)).query(pixels(truth))[0].mean())
    return float(np.linalg.norm(pixels(estimate) - pixels(truth), axis=1).mean())


def rotation_error_deg(estimate: np.ndarray, truth: np.ndarray) -> float:
    cosine = (np.trace(estimate[:3, :3].T @ truth[:3, :3]) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def translation_error_m(estimate: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(estimate[:3, 3] - truth[:3, 3]))
