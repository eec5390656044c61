"""A camera with OpenCV's lens model (k1, k2, p1, p2, k3), and how its pixels move with its parameters."""

import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from ..bop import DatasetError

NO_DISTORTION = np.zeros(5)


@dataclass(frozen=True)
class Camera:
    """Pixels; pixel centres at integers."""

    width: int
    height: int
    matrix: np.ndarray  # [3, 3]
    distortion: np.ndarray = field(default_factory=NO_DISTORTION.copy)  # [5]: k1 k2 p1 p2 k3, or [8] with k4 k5 k6

    @property
    def distorted(self) -> bool:
        return bool(np.any(self.distortion))

    def scaled(self, width: int, height: int) -> "Camera":
        """The camera of the images when resized."""
        across, down = width / self.width, height / self.height
        if abs(across / down - 1) > 0.01:
            raise DatasetError(
                f"the camera file is for {self.width}x{self.height} px, the photos have {width}x{height}: another "
                "aspect ratio, so they are not this camera's, or were cropped"
            )
        scale = np.array([[across, 0, (across - 1) / 2], [0, down, (down - 1) / 2], [0, 0, 1]])
        return replace(self, width=width, height=height, matrix=scale @ self.matrix)

    def undistort(self, image: np.ndarray) -> np.ndarray:
        """The image as a pinhole camera of the same matrix sees it."""
        return cv2.undistort(image, self.matrix, self.distortion) if self.distorted else image

    def undistort_points(self, pixels: np.ndarray) -> np.ndarray:
        if not self.distorted or not len(pixels):
            return pixels
        flat = np.ascontiguousarray(pixels, float).reshape(-1, 1, 2)
        return cv2.undistortPoints(flat, self.matrix, self.distortion, P=self.matrix).reshape(pixels.shape)

    def as_dict(self) -> dict:
        """posed's camera file."""
        fx, fy, cx, cy = (float(self.matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
        values = {"width": self.width, "height": self.height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
        if not self.distorted:
            return {"model": "pinhole"} | values
        return {"model": "opencv"} | values | {"distortion": self.distortion.tolist()}


def read_camera(path: Path) -> Camera:
    """A camera file of posed's."""
    try:
        return parse_camera(json.loads(path.read_text()), str(path))
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}") from None
    except json.JSONDecodeError as error:
        raise DatasetError(f"{path}: not a camera file ({error})") from None


def parse_camera(values: dict, path: str) -> Camera:
    try:
        size = int(values["width"]), int(values["height"])
        matrix = np.array([[values["fx"], 0, values["cx"]], [0, values["fy"], values["cy"]], [0, 0, 1]], float)
        distortion = np.array(values.get("distortion", NO_DISTORTION), float).ravel()
    except (ValueError, TypeError) as error:
        raise DatasetError(f"{path}: not a camera file ({error})") from None
    except KeyError as error:
        raise DatasetError(f"{path}: a camera file needs {error.args[0]!r}: width, height, fx, fy, cx, cy") from None
    if not np.isfinite(matrix).all() or min(matrix[0, 0], matrix[1, 1], *size) <= 0:
        raise DatasetError(f"{path}: fx, fy, width and height must be above 0")
    if len(distortion) not in (0, 4, 5, 8):
        raise DatasetError(f"{path}: distortion has {len(distortion)} values; OpenCV's model has 4, 5 or 8")
    padded = np.zeros(max(5, len(distortion)))
    padded[: len(distortion)] = distortion
    return Camera(*size, matrix, padded)
