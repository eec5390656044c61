"""Another light on a shape."""

import numpy as np


def relight(points: np.ndarray, normals: np.ndarray, camera: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What another light multiplies colours by, `[P, 3]`: one to three lamps, of which each may be tinted and mirrored
    in a glossy surface, and light from everywhere."""
    light = np.full((len(points), 3), rng.uniform(0.25, 1.0))
    towards_camera = camera - points
    towards_camera /= np.linalg.norm(towards_camera, axis=1, keepdims=True)
    for _ in range(rng.integers(1, 4)):
        lamp = rng.normal(size=3)
        lamp /= np.linalg.norm(lamp)
        tint = np.exp(rng.normal(0, 0.12, 3))
        light += rng.uniform(0.2, 1.2) * np.clip(normals @ lamp, 0, None)[:, None] * tint
        halfway = lamp + towards_camera
        halfway /= np.linalg.norm(halfway, axis=1, keepdims=True) + 1e-9
        if rng.random() < 0.5:
            gloss = np.clip((normals * halfway).sum(1), 0, 1) ** rng.uniform(8, 60)
            light += rng.uniform(0.1, 1.2) * gloss[:, None]
    return light / np.median(light) * rng.uniform(0.75, 1.25)
