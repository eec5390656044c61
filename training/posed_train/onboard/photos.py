"""Photos and videos as they come from cameras: found, read, judged by their sharpness."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, UnidentifiedImageError

from ..bop import DatasetError

IMAGES = {".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff"}
VIDEOS = {".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v"}
UNREADABLE = {".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf"}
CANDIDATES_PER_FRAME = 4
EXIF_ORIENTATION = 0x0112
TURNS = {1: 0, 6: 1, 3: 2, 8: 3}
"""Quarter turns to the right that make a photo upright, by its EXIF orientation; all others are mirrored."""
SHARPNESS_WIDTH = 960
DEFAULT_MAX_PX = 1920
MAX_PIXELS = 200_000_000
DRAFT = 64, 64
"""A JPEG need not be decoded in full to see that it is whole."""
NAMED = 5
SHARP = 0.55
"""Sharpness of photos of a board that a Gaussian of 1.3 px has blurred."""


@dataclass(frozen=True)
class Photo:
    """A photo as the sensor saw it, whichever way up the camera was held: so all photos share one camera matrix."""

    name: str
    path: Path
    width: int
    height: int
    """As it is read: large photos are made smaller."""
    turns: int
    """Quarter turns to the right that make it upright."""
    unscaled: bool = True
    mirrored: bool = False
    """Stored mirrored, with a note of it: turned back when it is read, `turns` included."""
    stored: tuple[int, int] = (0, 0)
    """Width and height in the file."""
    orientation: int = 1
    """As EXIF has it: how the stored image becomes an upright one."""

    def read(self, flags: int = cv2.IMREAD_COLOR) -> np.ndarray:
        if not self.mirrored:
            flags |= cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imread(str(self.path), flags)
        if image is None:
            raise DatasetError(f"{self.path}: not a readable image")
        if image.shape[1] != self.width:
            image = cv2.resize(image, (self.width, self.height), interpolation=cv2.INTER_AREA)
        return image

    def read_grey(self) -> np.ndarray:
        return self.read(cv2.IMREAD_GRAYSCALE)


def natural(path: Path) -> list:
    """Sorts IMG_2 before IMG_10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name.lower())]


def find_photos(source: Path, max_px: int = DEFAULT_MAX_PX) -> tuple[list[Photo], list[str]]:
    """The photos of a folder in the order of their names, and why others cannot be used."""
    if not source.exists():
        raise DatasetError(f"{source}: no such folder or video")
    photos, refused = [], []
    for path in sorted(source.iterdir(), key=natural):
        suffix = path.suffix.lower()
        if suffix in UNREADABLE:
            refused.append(f"{path.name}: {suffix[1:].upper()} cannot be read; export it as JPEG")
        elif suffix in IMAGES:
            try:
                photos.append(open_photo(path, max_px))
            except DatasetError as error:
                refused.append(str(error).removeprefix(f"{path.parent}/"))
    if not photos:
        reasons = "".join(f"\n  {reason}" for reason in refused[:10])
        raise DatasetError(f"{source}: no photo that can be read (JPEG, PNG, WebP, TIFF){reasons}")
    return photos, refused


def open_photo(path: Path, max_px: int = DEFAULT_MAX_PX) -> Photo:
    """`max_px` limits the longer side."""
    try:
        with Image.open(path) as image:
            (width, height), orientation = image.size, image.getexif().get(EXIF_ORIENTATION, 1)
            stored = image.size
            if width * height <= MAX_PIXELS:
                image.draft(None, DRAFT)
                image.load()  # OpenCV fills what is missing of a cut file with grey
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        raise DatasetError(f"{path}: not a readable image") from None
    if width * height > MAX_PIXELS:
        raise DatasetError(f"{path}: {width}x{height} px is more than {MAX_PIXELS // 10**6} megapixels")
    if orientation in (5, 7):
        width, height = height, width
    unscaled = (scale := max_px / max(width, height)) >= 1
    if not unscaled:
        width, height = round(width * scale), round(height * scale)
    if orientation in (2, 4, 5, 7):
        return Photo(path.name, path, width, height, 0, unscaled, True, stored, orientation)
    turns = TURNS.get(orientation, 0)
    return Photo(path.name, path, width, height, turns, unscaled, False, stored, orientation if turns else 1)


def listed(names: Iterable[object]) -> str:
    """The first few, each once, and how many more."""
    words = [str(name) for name in dict.fromkeys(names)]
    return ", ".join(words[:NAMED]) + (f" and {len(words) - NAMED} more" if len(words) > NAMED else "")


def of_one_size(photos: list[Photo]) -> tuple[int, int]:
    """The size that all photos have; refuses a mixture, for it is of several cameras."""
    sizes = [(photo.width, photo.height) for photo in photos]
    usual = max(set(sizes), key=sizes.count)
    others = [photo for photo, size in zip(photos, sizes) if size != usual]
    if others:
        names = listed(f"{photo.name} ({photo.width}x{photo.height})" for photo in others)
        raise DatasetError(
            f"most photos have {usual[0]}x{usual[1]} px, but {names}: take all photos with one camera, without "
            "zoom, and do not crop or turn them afterwards"
        )
    return usual


def read_frames(video: Path, count: int, folder: Path, max_px: int = DEFAULT_MAX_PX) -> list[Photo]:
    """`count` frames of a video, spread evenly, each the sharpest of its neighbourhood; `folder` gets them as files."""
    capture = cv2.VideoCapture(str(video))
    total = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    if not capture.isOpened() or total < 2:
        raise DatasetError(f"{video}: not a video that OpenCV can read")
    every = max(1, total // (count * CANDIDATES_PER_FRAME))
    best: dict[int, tuple[float, int]] = {}
    for number in range(total):
        if not capture.grab():
            break
        if number % every:
            continue
        good, frame = capture.retrieve()
        if good:
            place, value = number * count // total, sharpness(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))
            if place not in best or value > best[place][0]:
                best[place] = value, number
                write_frame(folder / f"{place:06d}.png", frame)
    capture.release()
    return [
        replace(open_photo(folder / f"{place:06d}.png", max_px), name=f"{video.stem}-{number:06d}.png")
        for place, (_, number) in sorted(best.items())
    ]


def write_frame(path: Path, frame: np.ndarray) -> None:
    if not cv2.imwrite(str(path), frame, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
        raise OSError(f"{path}: cannot write the frame; is the disk full?")


def blurred(sharp: Sequence[float]) -> str:
    """Words, if photos of a board are; empty if they are not."""
    usual = float(np.median(sharp))
    if usual >= SHARP:
        return ""
    return (
        f"the photos are blurred (sharpness {usual:.2f}; sharp ones of a board have 1 to 5): more light, a steadier "
        "camera, the focus on the object"
    )


def sharpness(image: np.ndarray) -> float:
    """How steep the edges of a grey image are compared with its contrast: blur lowers it, light does not."""
    scale = SHARPNESS_WIDTH / max(image.shape)
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
    steepness = np.abs(cv2.Laplacian(small, cv2.CV_32F))
    return float(np.percentile(steepness, 99) / max(float(small.std()), 1.0))
