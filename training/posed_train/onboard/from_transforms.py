"""`transforms.json` of nerfstudio and instant-ngp: camera-to-world matrices with OpenGL's camera axes."""

import json
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from .camera import Camera
from .photos import open_photo
from .posed_photos import CORNER_TO_CENTRE, Posed, find_image

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
MODELS = (None, "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")


def read_transforms(path: Path, photos: Path | None) -> list[Posed]:
    """The photos are beside the file, or in `photos`."""
    try:
        values = json.loads(path.read_text())
        frames = values["frames"]
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path}: not a transforms.json ({error!r})") from None
    folders = [folder for folder in (photos, path.parent) if folder is not None]
    return [read_frame(frame, values, folders, f"{path}: frame {k}") for k, frame in enumerate(frames)]


def read_frame(frame: dict, common: dict, folders: list[Path], where: str) -> Posed:
    try:
        name = str(frame["file_path"])
        world_from_opengl = np.array(frame["transform_matrix"], float)
        if world_from_opengl.shape == (3, 4):
            world_from_opengl = np.vstack([world_from_opengl, [0, 0, 0, 1]])
        if world_from_opengl.shape != (4, 4):
            raise DatasetError(f"{where}: transform_matrix must be 4 by 4")
        path = find_image(folders, name if Path(name).suffix else f"{name}.png", where)
        camera = read_camera(common | frame, path, where)
        pose = OPENCV_FROM_OPENGL @ np.linalg.inv(world_from_opengl)
    except (KeyError, ValueError, TypeError) as error:
        if isinstance(error, DatasetError):
            raise
        raise DatasetError(f"{where}: {error!r}") from None
    except np.linalg.LinAlgError:
        raise DatasetError(f"{where}: transform_matrix cannot be inverted") from None
    return Posed(Path(name).name, path, camera, pose)


def read_camera(values: dict, path: Path, where: str) -> Camera:
    model = values.get("camera_model")
    if model not in MODELS:
        raise DatasetError(f"{where}: camera_model {model!r}: undistort the photos first, or use OPENCV")
    if "w" in values and "h" in values:
        width, height = int(values["w"]), int(values["h"])
    else:
        photo = open_photo(path)
        width, height = photo.width, photo.height
    if "fl_x" in values:
        fx = float(values["fl_x"])
    elif "camera_angle_x" in values:
        fx = width / 2 / np.tan(float(values["camera_angle_x"]) / 2)
    else:
        raise DatasetError(f"{where}: has neither fl_x nor camera_angle_x")
    fy = float(values.get("fl_y", fx))
    cx, cy = float(values.get("cx", width / 2)), float(values.get("cy", height / 2))
    matrix = np.array([[fx, 0, cx - CORNER_TO_CENTRE], [0, fy, cy - CORNER_TO_CENTRE], [0, 0, 1]])
    k1, k2, k3, k4, p1, p2 = (float(values.get(name, 0)) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    distortion = np.array([k1, k2, p1, p2, k3])
    if k4:
        distortion = rational(k1, k2, k3, k4, p1, p2, reach=float(np.hypot(width / fx, height / fy)) / 2)
    return Camera(width, height, matrix, distortion)


def rational(k1: float, k2: float, k3: float, k4: float, p1: float, p2: float, reach: float) -> np.ndarray:
    """OpenCV's `[8]` that bends as a polynomial of four radial terms does, out to `reach` from the axis: OpenCV's own
    k4 is another thing."""
    r2 = np.linspace(0, reach, 200) ** 2
    wanted = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    powers = np.stack([r2, r2**2, r2**3], axis=1)
    found = np.linalg.lstsq(np.hstack([powers, -wanted[:, None] * powers]), wanted - 1, rcond=None)[0]
    return np.array([found[0], found[1], p1, p2, found[2], *found[3:]])
