"""COLMAP's sparse model, text or binary: https://colmap.github.io/format.html"""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from .camera import Camera
from .posed_photos import CORNER_TO_CENTRE, Posed, find_image, quaternion_pose

MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
}
ONE_FOCAL_LENGTH = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
MAX_NAME = 4096


def read_colmap(folder: Path, photos: Path | None) -> list[Posed]:
    """The model is in `folder` or in its `sparse/0`; the photos in `photos`, or in `images` beside it."""
    for model in (folder, folder / "sparse/0", folder / "sparse"):
        for suffix, cameras_of, images_of in (
            (".bin", binary_cameras, binary_images),
            (".txt", text_cameras, text_images),
        ):
            if (model / f"cameras{suffix}").exists() and (model / f"images{suffix}").exists():
                cameras = dict(guarded(cameras_of, model / f"cameras{suffix}"))
                images = list(guarded(images_of, model / f"images{suffix}"))
                return assemble(cameras, images, [photos] if photos else image_folders(folder), model)
    raise DatasetError(f"{folder}: no COLMAP model (cameras and images, .bin or .txt) there or in sparse/0")


def image_folders(folder: Path) -> list[Path]:
    return [folder / "images", folder, folder.parent / "images", folder.parent.parent / "images"]


def guarded(read, path: Path) -> Iterator:
    try:
        yield from read(path)
    except (struct.error, ValueError, IndexError, UnicodeDecodeError) as error:
        if isinstance(error, DatasetError):
            raise
        raise DatasetError(f"{path}: broken ({error})") from None


def assemble(cameras: dict[int, Camera], images: list[tuple], folders: list[Path], model: Path) -> list[Posed]:
    posed = []
    for name, pose, camera in sorted(images, key=lambda image: image[0]):
        if camera not in cameras:
            raise DatasetError(f"{model}: {name} is of camera {camera}, which the model does not have")
        posed.append(Posed(Path(name).name, find_image(folders, name, str(model)), cameras[camera], pose))
    return posed


def make_camera(model: str, width: int, height: int, p: list[float], where: str) -> Camera:
    expected = dict(MODELS.values()).get(model)
    if expected is None or "FISHEYE" in model or model == "FOV":
        raise DatasetError(f"{where}: camera model {model}: run `colmap image_undistorter` first, which makes PINHOLE")
    if len(p) != expected:
        raise DatasetError(f"{where}: camera model {model} has {expected} parameters, not {len(p)}")
    if model in ONE_FOCAL_LENGTH:
        p = [p[0], *p]
    fx, fy, cx, cy, *rest = p
    matrix = np.array([[fx, 0, cx - CORNER_TO_CENTRE], [0, fy, cy - CORNER_TO_CENTRE], [0, 0, 1]])
    distortion = np.zeros(max(5, len(rest)))
    distortion[: len(rest)] = rest  # k1 k2 p1 p2 k3 ..., as OpenCV has them
    return Camera(width, height, matrix, distortion)


def text_cameras(path: Path) -> Iterator[tuple[int, Camera]]:
    for line in content(path):
        number, model, width, height, *parameters = line.split()
        yield int(number), make_camera(model, int(width), int(height), [float(v) for v in parameters], str(path))


def text_images(path: Path) -> Iterator[tuple[str, np.ndarray, int]]:
    """Two lines an image; the second one, its points, may be empty."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    for line in lines[::2]:
        if not line.strip():
            continue
        _, *numbers, camera, name = line.split(maxsplit=9)
        pose = quaternion_pose([float(v) for v in numbers[:4]], [float(v) for v in numbers[4:7]], f"{path}: {name}")
        yield name, pose, int(camera)


def content(path: Path) -> list[str]:
    return [line for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]


def binary_cameras(path: Path) -> Iterator[tuple[int, Camera]]:
    data = path.read_bytes()
    (count,) = struct.unpack_from("<Q", data, 0)
    at = 8
    for _ in range(count):
        number, kind, width, height = struct.unpack_from("<IiQQ", data, at)
        if kind not in MODELS:
            raise DatasetError(f"{path}: camera model number {kind} is not known")
        name, parameters = MODELS[kind]
        values = struct.unpack_from(f"<{parameters}d", data, at + 24)
        at += 24 + 8 * parameters
        yield number, make_camera(name, width, height, list(values), str(path))


def binary_images(path: Path) -> Iterator[tuple[str, np.ndarray, int]]:
    data = path.read_bytes()
    (count,) = struct.unpack_from("<Q", data, 0)
    at = 8
    for _ in range(count):
        _, *numbers, camera = struct.unpack_from("<I7dI", data, at)
        at += 64
        end = data.index(b"\0", at, at + MAX_NAME)
        name = data[at:end].decode()
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points
        yield name, quaternion_pose(numbers[:4], numbers[4:], f"{path}: {name}"), camera
