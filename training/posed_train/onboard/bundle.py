"""Bundle adjustment over tag corners: camera poses, the board's layout and, if it is not known, the camera at once.

Levenberg-Marquardt on dense normal equations with Huber weights; poses move by a small rotation and translation on the
camera's side. Detectors put the corners of a tag some tenths of a pixel too far inwards, which makes near tags larger
than far ones and the whole board too small by a percent: that `inset` is a parameter, too.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import coo_matrix
from scipy.spatial.transform import Rotation

HUBER_PX = 1.0
MAX_STEPS = 40
CAMERA_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "inset")


@dataclass
class Problem:
    """Corners of a flat board as photos show them."""

    photo: np.ndarray  # [O] which photo
    corner: np.ndarray  # [O] which corner of the board
    pixel: np.ndarray  # [O, 2]
    outward: np.ndarray  # [O, 2] unit directions away from the tag's centre
    camera_from_board: np.ndarray  # [P, 4, 4]
    corners: np.ndarray  # [C, 2] metres
    camera: np.ndarray  # [10], CAMERA_PARAMETERS
    free: tuple[str, ...]  # of CAMERA_PARAMETERS
    free_layout: bool = True
    deviation: dict[str, float] = field(default_factory=dict)
    """How well the free camera parameters are determined, one standard deviation (after `solve`)."""

    @property
    def free_columns(self) -> list[int]:
        return [CAMERA_PARAMETERS.index(name) for name in self.free]


def in_cameras(problem: Problem) -> np.ndarray:
    poses = problem.camera_from_board[problem.photo]
    points = problem.corners[problem.corner]
    return np.einsum("oij,oj->oi", poses[:, :3, :2], points) + poses[:, :3, 3]


def project(camera: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels `[O, 2]` of points `[O, 3]` in the camera."""
    return project_with_slopes(camera, points)[0]


def project_with_slopes(camera: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels `[O, 2]`, and their derivatives by the point `[O, 2, 3]` and by the camera's lens `[O, 2, 9]`."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = camera[:9]
    z = points[:, 2]
    x, y = points[:, 0] / z, points[:, 1] / z
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    bend = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    cross = x * y * bend + 2 * p1 * x + 2 * p2 * y
    ux, vy = radial + x * x * bend + 2 * p1 * y + 6 * p2 * x, radial + y * y * bend + 6 * p1 * y + 2 * p2 * x
    by_point = np.empty((len(points), 2, 3))
    by_point[:, 0] = fx * np.stack([ux / z, cross / z, -(ux * x + cross * y) / z], axis=1)
    by_point[:, 1] = fy * np.stack([cross / z, vy / z, -(cross * x + vy * y) / z], axis=1)
    zero, one = np.zeros_like(x), np.ones_like(x)
    by_camera = np.zeros((len(points), 2, 9))
    by_camera[:, 0] = np.stack([u, zero, one, zero, *(fx * np.stack(bends(x, y, r2)))], axis=1)
    by_camera[:, 1] = np.stack([zero, v, zero, one, *(fy * np.stack(bends(y, x, r2, swapped=True)))], axis=1)
    return np.stack([fx * u + cx, fy * v + cy], axis=1), by_point, by_camera


def bends(along: np.ndarray, other: np.ndarray, r2: np.ndarray, swapped: bool = False) -> list[np.ndarray]:
    """How a coordinate moves with k1, k2, p1, p2 and k3."""
    tangential = [2 * along * other, r2 + 2 * along * along]
    return [along * r2, along * r2**2, *(tangential[::-1] if swapped else tangential), along * r2**3]


def residuals(problem: Problem) -> np.ndarray:
    """`[O, 2]` pixels."""
    return project(problem.camera, in_cameras(problem)) - problem.camera[9] * problem.outward - problem.pixel


def huber(errors: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights `[O]` and the cost."""
    size = np.linalg.norm(errors, axis=1)
    weights = np.minimum(1, HUBER_PX / np.maximum(size, 1e-12))
    cost = np.where(size <= HUBER_PX, size**2, HUBER_PX * (2 * size - HUBER_PX)).sum()
    return weights, float(cost)


def jacobian(problem: Problem):
    """Sparse `[2 O, free camera + 6 P + 2 C]`."""
    points = in_cameras(problem)
    _, by_point, by_camera = project_with_slopes(problem.camera, points)
    rotated = points - problem.camera_from_board[problem.photo, :3, 3]
    turn = np.zeros((len(points), 3, 3))  # of the point when the camera's frame turns: -[R X]x
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        turn[:, i, j], turn[:, j, i] = rotated[:, k], -rotated[:, k]
    by_camera = np.concatenate([by_camera, -problem.outward[..., None]], axis=2)
    blocks = [by_camera[:, :, problem.free_columns], by_point @ turn, by_point]
    count, poses = len(problem.free), len(problem.camera_from_board)
    columns = [
        np.broadcast_to(np.arange(count), (len(points), count)),
        count + 6 * problem.photo[:, None] + np.arange(6),
    ]
    width = count + 6 * poses
    if problem.free_layout:
        blocks.append(by_point @ problem.camera_from_board[problem.photo][:, :3, :2])
        columns.append(width + 2 * problem.corner[:, None] + np.arange(2))
        width += 2 * len(problem.corners)
    values, columns = np.concatenate(blocks, axis=2), np.concatenate(columns, axis=1)
    rows = np.broadcast_to(np.arange(2 * len(points)).reshape(-1, 2, 1), values.shape)
    columns = np.broadcast_to(columns[:, None], values.shape)
    return coo_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=(2 * len(points), width)).tocsr()


def moved(problem: Problem, step: np.ndarray) -> Problem:
    count, poses = len(problem.free), len(problem.camera_from_board)
    camera = problem.camera.copy()
    camera[problem.free_columns] += step[:count]
    twists = step[count : count + 6 * poses].reshape(-1, 6)
    new = problem.camera_from_board.copy()
    new[:, :3, :3] = Rotation.from_rotvec(twists[:, :3]).as_matrix() @ new[:, :3, :3]
    new[:, :3, 3] += twists[:, 3:]
    corners = problem.corners
    if problem.free_layout:
        corners = corners + step[count + 6 * poses :].reshape(-1, 2)
    return replace(problem, camera_from_board=new, corners=corners, camera=camera)


def solve(problem: Problem) -> Problem:
    """The adjusted problem. Its frame and scale are those of the start, about: nothing in it fixes them."""
    damping, (weights, cost) = 1e-4, huber(residuals(problem))
    for _ in range(MAX_STEPS):
        slopes = jacobian(problem)
        doubled = np.repeat(weights, 2)
        normal = (slopes.T @ slopes.multiply(doubled[:, None]).tocsr()).toarray()
        gradient = slopes.T @ (doubled * residuals(problem).ravel())
        diagonal = np.maximum(np.diag(normal), 1e-9)
        gained = 0.0
        while damping < 1e8:
            candidate = moved(problem, cho_solve(cho_factor(normal + np.diag(damping * diagonal)), -gradient))
            new_weights, new_cost = huber(residuals(candidate))
            if new_cost < cost:
                gained = (cost - new_cost) / cost
                problem, weights, cost, damping = candidate, new_weights, new_cost, max(damping / 10, 1e-9)
                break
            damping *= 10
        if gained < 1e-6:
            break
    problem.deviation = deviations(problem, normal, cost)
    return problem


def deviations(problem: Problem, normal: np.ndarray, cost: float) -> dict[str, float]:
    """The camera parameters' standard deviations, everything else being free."""
    count = len(problem.free)
    if not count:
        return {}
    rest = normal[count:, count:]
    # The frame and scale of the board are free; holding them weakly changes nothing of the camera.
    held = rest + np.diag(1e-9 * np.diag(rest) + 1e-12)
    information = normal[:count, :count] - normal[:count, count:] @ cho_solve(cho_factor(held), normal[count:, :count])
    freedom = max(1, 2 * len(problem.photo) - len(normal))
    covariance = np.linalg.pinv(information) * cost / freedom
    return dict(zip(problem.free, np.sqrt(np.maximum(np.diag(covariance), 0)).tolist()))
