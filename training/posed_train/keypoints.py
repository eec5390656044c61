"""Virtual keypoints: 3D points that exist nowhere on the object, which the network learns to see.

They may lie anywhere, so they are chosen for the pose solver: well spread, about the object's centre, on a sphere of
about its size (paper, section 3.3 and table 5).
"""

import numpy as np

GOLDEN = (1 + np.sqrt(5)) / 2
SOLIDS = {
    "tetrahedron": [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]],
    "octahedron": [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]],
    "cube": [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)],
    "icosahedron": [point for a in (-1, 1) for b in (-GOLDEN, GOLDEN) for point in ([0, a, b], [a, b, 0], [b, 0, a])],
}
SOLIDS["rhombic-dodecahedron"] = SOLIDS["cube"] + SOLIDS["octahedron"]
"""Solids by the directions of their vertices, before scaling."""
SHAPES = (*SOLIDS, "r-sphere", "r-volume")
MAX_KEYPOINTS = 16  # what the solver takes
MIN_SPREAD = 0.1
"""Least over greatest singular value of the centred points: below this they are nearly flat, and the pose is not."""
MAX_DRAWS = 1000


def spread(points: np.ndarray) -> float:
    """Least over greatest singular value of the centred points: 1 for a regular solid, 0 for points of a plane."""
    singular = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return float(singular[-1] / singular[0])


def virtual_keypoints(shape: str, radius: float, count: int, seed: int) -> np.ndarray:
    """`[N, 3]` metres, in the frame `keypoints`, whose origin is the object's centre.

    `count` says how many for the random shapes: `r-sphere` on a sphere of this radius, `r-volume` within it. A draw
    that is nearly flat, or has two points close together, is drawn again.
    """
    if shape in SOLIDS:
        points = np.array(SOLIDS[shape], dtype=float)
        return radius * points / np.linalg.norm(points, axis=1, keepdims=True)
    if shape not in SHAPES:
        raise ValueError(f"keypoint_shape {shape!r}: choose one of {', '.join(SHAPES)}")
    if not 4 <= count <= MAX_KEYPOINTS:
        raise ValueError(f"keypoint_count {count}: a pose needs 4 to {MAX_KEYPOINTS} keypoints")
    rng = np.random.default_rng(seed)
    for _ in range(MAX_DRAWS):
        directions = rng.normal(size=(count, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        points = directions if shape == "r-sphere" else directions * rng.uniform(size=(count, 1)) ** (1 / 3)
        apart = np.linalg.norm(points[:, None] - points[None], axis=-1) + 9 * np.eye(count)
        if spread(points) > MIN_SPREAD and apart.min() > 0.2:
            return radius * points
    raise ValueError(f"keypoint_shape {shape!r} with {count} keypoints: no draw of {MAX_DRAWS} was spread well enough")
