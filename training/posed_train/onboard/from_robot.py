"""A camera on a robot's flange: rows of `image x y z qx qy qz qw` or `image x y z rx ry rz` (a rotation vector), which
are `base_from_flange`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ..bop import DatasetError
from ..midway import change
from .camera import Camera
from .posed_photos import Posed, find_image, quaternion_pose

LEAST_FOR_HAND_EYE = 6
LEAST_TURN_DEG = 15.0


def read_rows(path: Path) -> dict[str, np.ndarray]:
    """`base_from_flange` `[4, 4]` by the image's name, in the file's unit. Commas or blanks; # begins a remark."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: {error}") from None
    rows = {}
    for number, line in enumerate(lines, 1):
        cells = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        if not cells:
            continue
        if number == 1 and len(cells) > 1 and not is_number(cells[1]):
            continue  # a heading
        rows[cells[0]] = read_pose(cells[1:], f"{path}: line {number}")
    if not rows:
        raise DatasetError(f"{path}: no rows of image x y z qx qy qz qw")
    return rows


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_pose(cells: Sequence[str], where: str) -> np.ndarray:
    if len(cells) not in (6, 7) or not all(is_number(cell) for cell in cells):
        raise DatasetError(
            f"{where}: needs x y z and a quaternion (qx qy qz qw) or a rotation vector (rx ry rz, radians)"
        )
    values = [float(cell) for cell in cells]
    if len(values) == 7:
        x, y, z, w = values[3:]
        return quaternion_pose([w, x, y, z], values[:3], where)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(values[3:]).as_matrix(), values[:3]
    return pose


def read_robot(
    rows: dict[str, np.ndarray], flange_from_camera: np.ndarray, camera: Camera, photos: Path
) -> list[Posed]:
    """World = the robot's base; `flange_from_camera` in the rows' unit."""
    return [
        Posed(Path(name).name, find_image([photos], name, "--poses"), camera, np.linalg.inv(pose @ flange_from_camera))
        for name, pose in rows.items()
    ]


def hand_eye(base_from_flange: np.ndarray, camera_from_board: np.ndarray) -> tuple[np.ndarray, float, float]:
    """`flange_from_camera` `[4, 4]` from poses `[V, 4, 4]` of both, and how far the board seems to move in the base:
    degrees and metres, in the median.

    Rotations first, by their axes (Park and Martin, 1994), then translations, then both at once.
    """
    a, b = [], []
    for i in range(len(base_from_flange)):
        for j in range(i + 1, len(base_from_flange)):
            flange = np.linalg.inv(base_from_flange[j]) @ base_from_flange[i]
            camera = camera_from_board[j] @ np.linalg.inv(camera_from_board[i])
            if Rotation.from_matrix(flange[:3, :3]).magnitude() > np.radians(LEAST_TURN_DEG):
                a.append(flange)
                b.append(camera)
    if len(base_from_flange) < LEAST_FOR_HAND_EYE or len(a) < 2 * LEAST_FOR_HAND_EYE:
        raise DatasetError(
            f"hand-eye: {LEAST_FOR_HAND_EYE} photos or more are needed in which the flange is turned by "
            f"{LEAST_TURN_DEG:.0f} degrees or more from each other, about different axes; or give --flange-from-camera"
        )
    a, b = np.stack(a), np.stack(b)
    axes = [Rotation.from_matrix(m[:, :3, :3]).as_rotvec() for m in (a, b)]
    if np.linalg.svd(axes[0], compute_uv=False)[1] < 0.1 * np.linalg.norm(axes[0], ord=2):
        raise DatasetError("hand-eye: the flange turned about one axis only; turn it about a second one in some photos")
    turn = Rotation.align_vectors(*axes)[0].as_matrix()
    shift = np.linalg.lstsq(
        (a[:, :3, :3] - np.eye(3)).reshape(-1, 3),
        (np.einsum("ij,nj->ni", turn, b[:, :3, 3]) - a[:, :3, 3]).ravel(),
        rcond=None,
    )[0]
    return refine(base_from_flange, camera_from_board, turn, shift)


def board_moved(base_from_flange: np.ndarray, camera_from_board: np.ndarray) -> int | None:
    """The first photo after the board was moved in the robot's base, if it was: by the camera on the flange as the
    first photos tell it, or the last."""
    count, part = len(base_from_flange), max(LEAST_FOR_HAND_EYE, len(base_from_flange) // 3)
    for some in (slice(0, part), slice(count - part, count)):
        try:
            found, _, metres = hand_eye(base_from_flange[some], camera_from_board[some])
        except DatasetError:
            continue
        places = (base_from_flange @ found @ camera_from_board)[:, :3, 3]
        apart = np.linalg.norm(places - np.median(places[some], axis=0), axis=1)
        k = change(np.maximum(apart, metres))
        if k is not None:
            return k
    return None


def refine(base_from_flange, camera_from_board, turn, shift) -> tuple[np.ndarray, float, float]:
    first = np.eye(4)
    first[:3, :3], first[:3, 3] = turn, shift
    base_from_board = base_from_flange[0] @ first @ camera_from_board[0]

    def unpack(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        poses = []
        for start, q in ((first, p[:6]), (base_from_board, p[6:])):
            pose = start.copy()
            pose[:3, :3] = Rotation.from_rotvec(q[:3]).as_matrix() @ pose[:3, :3]
            pose[:3, 3] += q[3:]
            poses.append(pose)
        return poses[0], poses[1]

    def off(p: np.ndarray) -> np.ndarray:
        flange_from_camera, base_from_board = unpack(p)
        error = (
            np.linalg.inv(base_from_flange @ flange_from_camera) @ base_from_board @ np.linalg.inv(camera_from_board)
        )
        return np.concatenate([Rotation.from_matrix(error[:, :3, :3]).as_rotvec().ravel(), error[:, :3, 3].ravel()])

    best = least_squares(off, np.zeros(12), loss="soft_l1", f_scale=0.003)
    errors = off(best.x).reshape(2, -1, 3)
    degrees, metres = np.median(np.linalg.norm(errors, axis=-1), axis=-1)
    return unpack(best.x)[0], float(np.degrees(degrees)), float(metres)
