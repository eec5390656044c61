"""Copies of a split with one kind of trouble, from mild to strong: how far can answers about them be trusted?"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from .bop import DatasetError, image_path, read_json, read_rgb, write_image, write_rgb
from .colour import merge_hues, temperature_gains

STRENGTHS = 5
# By strength, the mildest first.
KELVIN = 5500, 8000, 4300, 10000, 2500
GAMMA = 0.85, 1.2, 0.7, 1.6, 0.45
JPEG = 60, 40, 25, 15, 10
BLUR_PX = 0.7, 1.2, 2.0, 3.0, 4.5
NOISE = 3.0, 6.0, 12.0, 20.0, 35.0
DESATURATED = 0.2, 0.4, 0.6, 0.8, 1.0
SWAPPED = 0.2, 0.4, 0.6, 0.8, 1.0
BITS = 12, 11, 10, 9, 8
COVERED = 0.1, 0.2, 0.3, 0.4, 0.5
MERGED_SEEDS = 1, 2, 3, 4, 5
FOCAL = 1.05, 0.95, 1.25, 0.5, 2.0


def white_balance(image: np.ndarray, kelvin: float) -> np.ndarray:
    return rounded(image * temperature_gains(kelvin))


def gamma(image: np.ndarray, exponent: float) -> np.ndarray:
    return rounded(255 * (image / 255.0) ** exponent)


def jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    _, encoded = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return cv2.imdecode(encoded, cv2.IMREAD_COLOR_RGB)


def blur(image: np.ndarray, sigma_px: float) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), sigma_px)


def noise(image: np.ndarray, sigma: float) -> np.ndarray:
    """More where it is bright, as photons make it."""
    rng = np.random.default_rng(0)
    return rounded(image + rng.normal(0, 1, image.shape) * sigma * np.sqrt((image + 16) / 128))


def desaturated(image: np.ndarray, share: float) -> np.ndarray:
    return rounded((1 - share) * image + share * image.mean(2, keepdims=True))


def swapped(image: np.ndarray, share: float) -> np.ndarray:
    """Towards an image whose red and blue are exchanged: OpenCV's order, taken for RGB."""
    return rounded((1 - share) * image + share * image[..., ::-1])


def few_bits(image: np.ndarray, bits: int) -> np.ndarray:
    """In the lower bits of a 16-bit image, as cameras of 12 bits write it."""
    return np.round(image / 255.0 * (2**bits - 1)).astype(np.uint16)


def merged(image: np.ndarray, seed: int) -> np.ndarray:
    return merge_hues(image, None, np.random.default_rng(seed))


def covered(image: np.ndarray, share: float, boxes: list[list[int]]) -> np.ndarray:
    """A patch of one colour over a part of every box."""
    rng, image = np.random.default_rng(len(boxes)), image.copy()
    for x, y, width, height in boxes:
        if min(width, height) < 1:  # out of sight
            continue
        w, h = int(width * share**0.5), int(height * share**0.5)
        left, top = x + rng.integers(0, width - w + 1), y + rng.integers(0, height - h + 1)
        image[max(top, 0) : top + h, max(left, 0) : left + w] = rng.integers(0, 256, 3)
    return image


def rounded(values: np.ndarray) -> np.ndarray:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


IMAGE_TROUBLES: dict[str, tuple[Callable, tuple]] = {
    "white-balance": (white_balance, KELVIN),
    "gamma": (gamma, GAMMA),
    "jpeg": (jpeg, JPEG),
    "blur": (blur, BLUR_PX),
    "noise": (noise, NOISE),
    "desaturated": (desaturated, DESATURATED),
    "swapped": (swapped, SWAPPED),
    "few-bits": (few_bits, BITS),
    "merged": (merged, MERGED_SEEDS),
}
"""By name: what is done to the image, and its parameter by strength."""
TROUBLES = (*IMAGE_TROUBLES, "covered", "wrong-camera")


def corrupt(split: Path, out: Path, trouble: str, strength: int, scenes: int | None = None) -> int:
    """Writes a copy of a BOP split, or of its last scenes, with this trouble; `strength` is 1 (mild) to 5. Poses stay
    as they are. Returns the number of images. A folder that exists is not written into."""
    if out.exists():
        raise OSError(f"{out}: exists already; remove it or write elsewhere")
    folders = sorted(path.parent for path in split.glob("*/scene_gt_info.json"))
    if not folders:
        raise DatasetError(f"{split}: holds no scene with scene_gt_info.json")
    return sum(
        corrupt_scene(scene, out / scene.name, trouble, strength - 1) for scene in tqdm(folders[-(scenes or 0) :])
    )


def corrupt_scene(scene: Path, out: Path, trouble: str, level: int) -> int:
    (out / "rgb").mkdir(parents=True)
    cameras, infos = read_json(scene / "scene_camera.json"), read_json(scene / "scene_gt_info.json")
    for key, camera in cameras.items():
        image = read_rgb(image_path(scene, int(key)))
        if trouble == "covered":
            image = covered(image, COVERED[level], [info["bbox_visib"] for info in infos[key]])
        elif trouble == "wrong-camera":
            camera["cam_K"][0] *= FOCAL[level]
            camera["cam_K"][4] *= FOCAL[level]
        else:
            apply, parameters = IMAGE_TROUBLES[trouble]
            image = apply(image, parameters[level])
        write = write_rgb if image.dtype == np.uint8 else lambda path, image: write_image(path, image[..., ::-1])
        write(out / f"rgb/{int(key):06d}.png", image)
    shutil.copy(scene / "scene_gt.json", out)
    shutil.copy(scene / "scene_gt_info.json", out)
    (out / "scene_camera.json").write_text(json.dumps(cameras))
    return len(cameras)
