"""Finds the tags of a printed board in photos. Pixel centres are at integers; corners start at the tag's own top left
and go clockwise."""

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np

from ..bop import DatasetError
from .edges import refine
from .photos import Photo, blurred, sharpness

FAMILIES = {
    "apriltag-36h11": cv2.aruco.DICT_APRILTAG_36h11,
    "apriltag-25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "apriltag-16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "aruco-4x4": cv2.aruco.DICT_4X4_1000,
    "aruco-5x5": cv2.aruco.DICT_5X5_1000,
    "aruco-6x6": cv2.aruco.DICT_6X6_1000,
    "aruco-7x7": cv2.aruco.DICT_7X7_1000,
    "aruco-original": cv2.aruco.DICT_ARUCO_ORIGINAL,
}
DEFAULT_FAMILY = "apriltag-36h11"
MIN_TAGS = 3
"""In a photo: fewer do not fix its pose to the accuracy that learning needs."""
PROBED_PHOTOS = 12
PLAIN = 8.0
"""Standard deviation of a grey image in which nothing is to be seen, sharp or not."""


@dataclass(frozen=True)
class Tags:
    """What is seen of a board in one photo."""

    ids: np.ndarray  # [T]
    corners: np.ndarray  # [T, 4, 2] pixels

    def __len__(self) -> int:
        return len(self.ids)


def detector(family: str) -> cv2.aruco.ArucoDetector:
    if family not in FAMILIES:
        raise ValueError(f"tag family {family!r}: choose one of {', '.join(FAMILIES)}")
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX  # a start for `refine`
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(FAMILIES[family]), parameters)


def find_tags(image: np.ndarray, family: str = DEFAULT_FAMILY) -> Tags:
    """Of a grey image `[H, W]`. An id that is seen twice is left out: nothing tells which of them is the board's."""
    corners, ids, _ = detector(family).detectMarkers(image)
    if ids is None or len(ids) == 0:
        return Tags(np.zeros(0, int), np.zeros((0, 4, 2)))
    ids, corners = ids.ravel(), np.concatenate(corners).reshape(-1, 4, 2).astype(float)
    once = np.array([(ids == tag).sum() == 1 for tag in ids])
    return Tags(ids[once], refine(image, corners[once]))


def find_all(photos: Sequence[Photo], family: str = DEFAULT_FAMILY) -> tuple[list[Tags], list[float]]:
    """The tags of every photo, and how sharp it is; refuses photos in which no board is seen, and says what is."""

    def look(photo: Photo) -> tuple[Tags, float]:
        image = photo.read_grey()
        return find_tags(image, family), sharpness(image)

    with ThreadPoolExecutor() as pool:
        found, sharp = zip(*pool.map(look, photos))
    if sum(len(tags) >= MIN_TAGS for tags in found) < 2:
        raise DatasetError(explain_missing(photos, family, sum(map(len, found))))
    return list(found), list(sharp)


def explain_missing(photos: Sequence[Photo], family: str, seen: int) -> str:
    """Why the photos do not show a board of that family, by trying what else it could be."""
    some = [photo.read_grey() for photo in photos[:: max(1, len(photos) // PROBED_PHOTOS)]]
    others = Counter({other: sum(len(find_tags(image, other)) for image in some) for other in FAMILIES})
    del others[family]
    other, count = others.most_common(1)[0]
    if count >= MIN_TAGS * max(1, len(some) // 2):
        return f"no board of {family} tags, but {count} tags of {other} in {len(some)} photos: give --family {other}"
    mirrored = sum(len(find_tags(np.ascontiguousarray(image[:, ::-1]), family)) for image in some)
    if mirrored >= MIN_TAGS * max(1, len(some) // 2):
        return (
            f"the photos are mirrored: flipped, {len(some)} of them show {mirrored} tags. Switch the camera's "
            "mirroring off, or flip the photos"
        )
    textured = [image for image in some if image.std() > PLAIN]
    words = blurred([sharpness(image) for image in textured]) if textured else ""
    return (
        f"{seen} tags of {family} in {len(photos)} photos; at least two photos must show {MIN_TAGS} tags each. Is the "
        "board in the photos, flat, sharp and with its white margin? `posed-train board` prints one"
        + (f"; {words}" if words else "")
    )
