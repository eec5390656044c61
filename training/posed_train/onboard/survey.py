"""Camera poses, the board's layout and the camera's parameters from the tags in photos."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..bop import DatasetError
from ..midway import change
from . import bundle
from .camera import Camera
from .layout import Board, connected, estimate_board
from .tags import MIN_TAGS, Tags

PHOTOS_FOR_FIRST_CAMERA = 40
MIN_PHOTOS_FOR_CAMERA = 10
LENS_GAIN = 0.05
"""Distortion is taken to be there if it makes the residuals smaller by this share."""
OUTLIER_PX = 5.0
SUSPECT_PX = 0.45
"""Tags that fit no better may have been moved."""
PINHOLE = ("fx", "fy", "cx", "cy")
MAX_FOCAL_DEVIATION = 0.01


@dataclass
class Survey:
    """What the tags say. World = board: metres, x right, y down on the sheet, z into it."""

    camera: Camera
    board: Board
    camera_from_world: dict[int, np.ndarray]  # [4, 4] by the photo's index
    residual_px: dict[int, float]  # root mean square by the photo's index
    apart: list[list[int]]  # groups of photos that show other tags
    deviation: dict[str, float]  # of the camera's parameters, if they were estimated

    @property
    def rms_px(self) -> float:
        return float(np.sqrt(np.mean(np.square(list(self.residual_px.values())))))


def survey(
    photos: list[Tags], size: tuple[int, int], tag_mm: float, camera: Camera | None = None, board: Board | None = None
) -> Survey:
    """Of photos of one camera, `size` being their width and height. Photos with too few tags get no pose. A `board`
    that is known stays as it is."""
    groups = connected(photos)
    if not groups or len(groups[0]) < 2:
        raise DatasetError(f"no two photos show {MIN_TAGS} tags or more of one board")
    group = groups[0]
    known = board is not None
    board = board or estimate_board(photos, group, tag_mm / 1000)
    given = camera is not None
    if not given and len(group) < MIN_PHOTOS_FOR_CAMERA:
        raise DatasetError(
            f"{len(group)} photos with tags are too few to tell the camera's parameters; take {MIN_PHOTOS_FOR_CAMERA} "
            "or more from several sides, or give them with --camera"
        )
    camera = camera or first_camera(photos, group, board, size)
    poses = {k: pose for k in group if (pose := first_pose(photos[k], board, camera)) is not None}
    problem = build(photos, poses, board, camera, ("inset",) if given else (*PINHOLE, "inset"), not known)
    problem = bundle.solve(without_outliers(bundle.solve(problem)))
    if not given:
        problem = with_lens(problem)
        spread = problem.deviation["fx"] / problem.camera[0]
        if spread > MAX_FOCAL_DEVIATION:
            raise DatasetError(
                f"the focal length is determined to {100 * spread:.1f} % only: tilt the camera more against the board "
                "in some photos, or give --camera"
            )
    return summarise(problem, list(poses), board, size, camera if given else None, groups[1:], tag_mm, known)


def changed_midway(
    photos: list[Tags], found: Survey, size: tuple[int, int], tag_mm: float, given: Camera | None
) -> int | None:
    """The first photo from which on the tags lie otherwise on the board than before: some of them were moved. Where
    they fit well there is none."""
    used = sorted(found.camera_from_world)
    part = max(MIN_PHOTOS_FOR_CAMERA, len(used) // 3)
    if found.rms_px < SUSPECT_PX or len(used) < 2 * part:
        return None
    for some in (used[:part], used[-part:]):
        try:
            alone = survey([photos[k] for k in some], size, tag_mm, given)
        except DatasetError:
            continue
        k = change(np.array([off_board(photos[k], alone) for k in used]))
        if k is not None:
            return used[k]
    return None


def off_board(tags: Tags, known: Survey) -> float:
    """How far a photo's tags lie from where a board has them, in the mean, pixels."""
    pose = first_pose(tags, known.board, known.camera)
    if pose is None:
        return OUTLIER_PX
    points, pixels = known.board.seen(tags)
    points = np.column_stack([points, np.zeros(len(points))])
    rvec = cv2.Rodrigues(pose[:3, :3])[0]
    seen, _ = cv2.projectPoints(points, rvec, pose[:3, 3], known.camera.matrix, known.camera.distortion)
    return float(np.linalg.norm(seen[:, 0] - pixels, axis=1).mean())


def first_camera(photos: list[Tags], group: list[int], board: Board, size: tuple[int, int]) -> Camera:
    """By OpenCV's calibration (Zhang), without distortion, from some of the photos."""
    most = sorted(group, key=lambda k: -len(photos[k]))
    some = most[:: max(1, len(most) // PHOTOS_FOR_FIRST_CAMERA)][:PHOTOS_FOR_FIRST_CAMERA]
    points, pixels = [], []
    for k in some:
        on_board, seen = board.seen(photos[k])
        points.append(np.column_stack([on_board, np.zeros(len(on_board))]).astype(np.float32))
        pixels.append(seen.astype(np.float32))
    fixed = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    _, matrix, *_ = cv2.calibrateCamera(points, pixels, size, None, None, flags=fixed | cv2.CALIB_FIX_ASPECT_RATIO)
    return Camera(*size, matrix)


def first_pose(tags: Tags, board: Board, camera: Camera) -> np.ndarray | None:
    points, pixels = board.seen(tags)
    if len(points) < 4 * MIN_TAGS:
        return None
    points = np.column_stack([points, np.zeros(len(points))])
    _, agreeing = cv2.findHomography(points[:, :2], camera.undistort_points(pixels), cv2.RANSAC, 2 * OUTLIER_PX)
    if agreeing is None or agreeing.sum() < 4 * MIN_TAGS - 2:
        return None
    points, pixels = points[agreeing.ravel() > 0], pixels[agreeing.ravel() > 0]
    lens = camera.matrix, camera.distortion
    found, rvec, tvec = cv2.solvePnP(points, pixels, *lens, flags=cv2.SOLVEPNP_IPPE)
    if not found or tvec[2] <= 0:
        return None
    rvec, tvec = cv2.solvePnPRefineLM(points, pixels, *lens, rvec, tvec)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rvec)[0], tvec.ravel()
    return pose


def build(
    photos: list[Tags], poses: dict[int, np.ndarray], board: Board, camera: Camera, free: tuple[str, ...], layout: bool
) -> bundle.Problem:
    first = {tag: 4 * k for k, tag in enumerate(board.corners)}
    photo, corner, pixel, outward = [], [], [], []
    for row, k in enumerate(poses):
        for tag, corners in zip(photos[k].ids.tolist(), photos[k].corners):
            if tag in first:
                photo += [row] * 4
                corner += range(first[tag], first[tag] + 4)
                pixel.append(corners)
                outward.append(corners - corners.mean(0))
    values = np.zeros(len(bundle.CAMERA_PARAMETERS))
    values[:4] = camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2]
    values[4:9] = camera.distortion[:5]
    return bundle.Problem(
        np.array(photo),
        np.array(corner),
        np.concatenate(pixel),
        np.concatenate(outward) / np.linalg.norm(np.concatenate(outward), axis=1, keepdims=True),
        np.stack(list(poses.values())),
        np.concatenate(list(board.corners.values())),
        values,
        free,
        layout,
    )


def without_outliers(problem: bundle.Problem) -> bundle.Problem:
    keep = np.linalg.norm(bundle.residuals(problem), axis=1) < OUTLIER_PX
    return replace(
        problem,
        photo=problem.photo[keep],
        corner=problem.corner[keep],
        pixel=problem.pixel[keep],
        outward=problem.outward[keep],
    )


def with_lens(problem: bundle.Problem) -> bundle.Problem:
    """With radial distortion, then with tangential, where each explains the photos better."""
    for more in (("k1", "k2"), ("p1", "p2")):
        bent = bundle.solve(replace(problem, free=problem.free + more))
        before, after = (np.median(np.linalg.norm(bundle.residuals(p), axis=1)) for p in (problem, bent))
        if after < (1 - LENS_GAIN) * before:
            problem = bent
    return problem


def summarise(
    problem: bundle.Problem,
    photos: list[int],
    board: Board,
    size: tuple[int, int],
    given: Camera | None,
    apart: list[list[int]],
    tag_mm: float,
    known_board: bool,
) -> Survey:
    corners = problem.corners.reshape(-1, 4, 2)
    scale = 1.0
    if not known_board:  # its frame and scale are those of the start, about
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
        scale = tag_mm / 1000 / np.median(sides)
    fx, fy, cx, cy = problem.camera[:4]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    camera = given or Camera(*size, matrix, problem.camera[4:9])
    size_px = np.linalg.norm(bundle.residuals(problem), axis=1)
    poses, residual = {}, {}
    for row, k in enumerate(photos):
        pose = problem.camera_from_board[row].copy()
        pose[:3, 3] *= scale
        mine = size_px[problem.photo == row]
        if len(mine) >= 4 * MIN_TAGS - 2:
            poses[k], residual[k] = pose, float(np.sqrt(np.mean(mine**2)))
    layout = Board({tag: corners[k] * scale for k, tag in enumerate(board.corners)})
    return Survey(camera, layout, poses, residual, apart, problem.deviation)
