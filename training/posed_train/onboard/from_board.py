"""Photos or a video of things on a board of tags become posed photos."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from .camera import Camera, read_camera
from .coverage import Row
from .layout import Board
from .photos import DEFAULT_MAX_PX, VIDEOS, Photo, blurred, find_photos, of_one_size, read_frames
from .scene import Shot
from .survey import Survey, changed_midway, survey
from .tags import DEFAULT_FAMILY, MIN_TAGS, Tags, find_all, find_tags

BLURRED = 0.45
"""Sharpness as a share of the median."""
HIGH_RESIDUAL = 3.0
"""Of the median."""
LEAST_DOUBTFUL_PX = 1.5
FEW_TAGS = 6
UP_FROM_BOARD = np.array([0, 0, -1.0])
STEEP = 0.8
"""Cosine: photos that look down more steeply tell nothing of what is up."""
TURNED = 0.5
FEW_TURNED = 0.1


@dataclass(frozen=True)
class BoardOptions:
    tag_mm: float
    span_mm: tuple[int, int, float] | None = None
    """Two tags and the distance of their centres by a ruler."""
    camera: Path | None = None
    family: str = DEFAULT_FAMILY
    max_px: int = DEFAULT_MAX_PX
    frames: int = 150
    """To be taken from a video."""
    without: tuple[str, ...] = ()
    """Names of photos to leave out."""
    first: str | None = None
    last: str | None = None
    """Names of the first and the last photo to take."""


@dataclass
class Imported:
    """Posed photos and what is to be said of them."""

    shots: list[Shot]
    rows: list[Row]
    notes: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    camera: Camera | None = None
    """If the photos told it."""
    tags: list[Tags] = field(default_factory=list)
    """Of the shots."""
    board: Board | None = None


def import_board(source: Path, options: BoardOptions, scratch: Path) -> Imported:
    """`scratch` is a folder for a video's frames."""
    if not 1 <= options.tag_mm <= 2000:
        raise DatasetError(f"--tag-mm {options.tag_mm}: the side of a tag's black square, 1 to 2000 mm")
    if source.suffix.lower() in VIDEOS and source.is_file():
        photos, refused = read_frames(source, options.frames, scratch, options.max_px), []
    elif source.is_file():
        raise DatasetError(f"{source}: give a folder of photos, or a video ({' '.join(sorted(VIDEOS))})")
    else:
        photos, refused = find_photos(source, options.max_px)
    photos = leave_out(photos, options)
    size = of_one_size(photos)
    tags, sharp = find_all(photos, options.family)
    camera = read_camera(options.camera).scaled(*size) if options.camera else None
    found = survey(tags, size, options.tag_mm, camera)
    refuse_changed(photos, changed_midway(tags, found, size, options.tag_mm, camera))
    notes = [*all_blurred(sharp), *scale_by_span(found, options), *describe(found, options, given=camera is not None)]
    imported = Imported([], [], notes, [*refused], None if camera else found.camera, board=found.board)
    usual_sharp = float(np.median(sharp))
    usual_px = float(np.median(list(found.residual_px.values())))
    for k, photo in enumerate(photos):
        row = Row(photo.name, len(tags[k]), found.residual_px.get(k), sharp[k] / usual_sharp)
        if k in found.camera_from_world:
            imported.shots.append(Shot(photo, found.camera, found.camera_from_world[k]))
            imported.rows.append(row)
            imported.tags.append(tags[k])
        reason = doubt(row, usual_px, any(k in group for group in found.apart))
        if row.residual_px is None and not any(k in group for group in found.apart) and is_mirrored(photo, options):
            reason = "left out: mirrored"
        if reason:
            imported.doubts.append(f"{photo.name}: {reason}")
    imported.doubts += upside_down(imported.shots)
    return imported


def refuse_changed(photos: list[Photo], k: int | None) -> None:
    if k is not None:
        before = photos[k - 1].name
        raise DatasetError(
            f"from {photos[k].name} on the tags lie otherwise on the board than in the photos before: it, or a part of "
            f"it, was moved: two components. Take the photos up to {before} (--to {before}), and give the others by "
            f"`posed-train add --from {photos[k].name}`"
        )


def all_blurred(sharp: list[float]) -> list[str]:
    words = blurred(sharp)
    return [f"{words}: camera and poses will be worse"] if words else []


def is_mirrored(photo: Photo, options: BoardOptions) -> bool:
    image = photo.read_grey()
    return len(find_tags(np.ascontiguousarray(image[:, ::-1]), options.family)) >= MIN_TAGS


def upside_down(shots: list[Shot]) -> list[str]:
    """Those photos that alone show the board the wrong way up, as if they had been turned after they were taken: their
    camera is another one then. Seen from above, a board has no wrong way."""
    found = []
    for shot in shots:
        _, pose = shot.upright
        up = pose[:3, :3] @ UP_FROM_BOARD
        if abs(up[2]) < STEEP:
            found.append((shot.photo.name, up[1] / np.hypot(up[0], up[1]) > TURNED))
    wrong = [name for name, turned in found if turned]
    if len(wrong) > FEW_TURNED * len(found):
        return []
    return [f"{name}: upside down against the others: if it was turned afterwards, turn it back" for name in wrong]


def leave_out(photos: list[Photo], options: BoardOptions) -> list[Photo]:
    names = [photo.name for photo in photos]
    for option, told in (("--without", options.without), ("--from", [options.first]), ("--to", [options.last])):
        unknown = sorted(set(told) - {*names, None})
        if unknown:
            raise DatasetError(f"{option} {unknown[0]}: no photo of that name")
    first = 0 if options.first is None else names.index(options.first)
    last = len(names) if options.last is None else names.index(options.last) + 1
    kept = [photo for photo in photos[first:last] if photo.name not in options.without]
    if not kept:
        raise DatasetError(f"--from {options.first} --to {options.last}: no photo is left")
    return kept


def doubt(row: Row, usual_px: float, apart: bool) -> str:
    if apart:
        return "left out: shows tags that the other photos do not show; if it is of another board, `add` it"
    if row.residual_px is None:
        return f"left out: {row.tags} tags, and {MIN_TAGS} in agreement are needed"
    if row.residual_px > max(HIGH_RESIDUAL * usual_px, LEAST_DOUBTFUL_PX):
        return f"its tags lie {row.residual_px:.1f} px from where the others put them"
    if row.sharpness < BLURRED:
        return "blurred"
    return f"{row.tags} tags only" if row.tags < FEW_TAGS else ""


def scale_by_span(found: Survey, options: BoardOptions) -> list[str]:
    """Scales everything to a distance that was measured on the board."""
    if options.span_mm is None:
        return []
    a, b, measured = options.span_mm
    for tag in (a, b):
        if tag not in found.board.corners:
            known = ", ".join(str(tag) for tag in sorted(found.board.corners))
            raise DatasetError(f"--span-mm: no tag {tag:g} in the photos; they show {known}")
    now = 1000 * np.linalg.norm(found.board.corners[a].mean(0) - found.board.corners[b].mean(0))
    scale = measured / now if now else 0
    if not 0.9 < scale < 1.1:
        raise DatasetError(
            f"--span-mm: from the middle of tag {a:g} to that of tag {b:g} it is {now:.1f} mm by the tags' size of "
            f"{options.tag_mm:g} mm, but {measured:g} mm by ruler: measure both again"
        )
    for pose in found.camera_from_world.values():
        pose[:3, 3] *= scale
    found.board.corners = {tag: corners * scale for tag, corners in found.board.corners.items()}
    return [f"scale by --span-mm: {100 * (scale - 1):+.2f} % against the tags' size"]


def describe(found: Survey, options: BoardOptions, given: bool) -> list[str]:
    notes = [f"board of {len(found.board.corners)} tags; their corners fit to {found.rms_px:.2f} px"]
    camera, deviation = found.camera, found.deviation
    if not given:
        fx, fy, cx, cy = (camera.matrix[i, j] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
        notes.append(
            f"camera from the photos: fx {fx:.1f} ±{deviation['fx']:.1f}, fy {fy:.1f} ±{deviation['fy']:.1f}, "
            f"cx {cx:.1f} ±{deviation['cx']:.1f}, cy {cy:.1f} ±{deviation['cy']:.1f} px; "
            + (f"distortion {np.round(camera.distortion, 4).tolist()}" if camera.distorted else "no distortion")
        )
    if options.span_mm is None:
        a, b = farthest(found.board)
        notes.append(
            f"scale from the tags' side alone, good to about 0.5 %: measure from the middle of tag {a} to that of tag "
            f"{b} and give --span-mm {a} {b} MM"
        )
    for group in found.apart:
        notes.append(
            f"{len(group)} photos show tags that never occur together with the others': two boards, or two scenes"
        )
    return notes


def farthest(board: Board) -> tuple[int, int]:
    tags = sorted(board.corners)
    centres = np.stack([board.corners[tag].mean(0) for tag in tags])
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1)
    a, b = np.unravel_index(apart.argmax(), apart.shape)
    return tags[a], tags[b]
