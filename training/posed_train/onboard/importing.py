"""Reads poses of other tools, as the options of `new` say."""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from .camera import Camera, read_camera
from .from_board import BoardOptions, Imported, import_board
from .from_colmap import read_colmap
from .from_pairs import read_pairs
from .from_robot import board_moved, hand_eye, read_pose, read_robot, read_rows
from .from_transforms import read_transforms
from .overlap import in_words, join_pairs
from .photos import open_photo
from .posed_photos import Posed, find_image, open_all
from .scale import by_points, by_tags
from .scene import Shot

METRE_MM = 1000.0
LEAST_BASELINE_M, MOST_BASELINE_M = 1e-4, 10.0
MOVED_M = 0.004
"""A board that seems to move by that much may have been moved."""


def import_posed(options: argparse.Namespace) -> tuple[list[Imported], dict]:
    """The scenes, and what object.toml says of their source."""
    if options.pairs:
        scenes = read_pairs(options.pairs, options.source)
        opened = [open_all(pair, (options.unit_mm or METRE_MM) / METRE_MM, options.max_px) for pair in scenes]
        check_baselines(opened)
        source = {"source": str(options.pairs), "by": "pairs"}
        if options.apart:
            return [Imported(shots, []) for shots in opened], source
        joined = join_pairs(opened)
        imported = [Imported(shots, []) for shots in joined.components]
        imported[0].notes.extend(in_words(joined))
        return imported, source
    if options.poses:
        return [from_robot(options)], {"source": str(options.poses), "by": "poses"}
    if options.transforms:
        posed, source = read_transforms(options.transforms, options.source), options.transforms
    else:
        posed, source = read_colmap(options.colmap, options.source), options.colmap
    shots, note = in_metres(posed, options)
    by = "transforms" if options.transforms else "colmap"
    return [Imported(shots, [], [note])], {"source": str(source), "by": by}


def check_baselines(pairs: list[list[Shot]]) -> None:
    for left, right in pairs:
        apart_m = float(np.linalg.norm((right.camera_from_world @ np.linalg.inv(left.camera_from_world))[:3, 3]))
        names = f"{left.photo.name} and {right.photo.name}"
        if apart_m < LEAST_BASELINE_M:
            raise DatasetError(f"{names}: no distance between their cameras, so they say nothing of depth")
        if apart_m > MOST_BASELINE_M:
            raise DatasetError(
                f"{names}: their cameras are {apart_m:.0f} m apart; if the poses are in millimetres, give --unit-mm 1"
            )


def in_metres(posed: list[Posed], options: argparse.Namespace) -> tuple[list[Shot], str]:
    shots = open_all(posed, 1.0, options.max_px)
    if options.unit_mm:
        scale, note = options.unit_mm / METRE_MM, f"unit of the poses: {options.unit_mm:g} mm"
    elif options.distance:
        scale = by_points(shots, options.distance)
        note = f"scale by the clicked points: {1000 * scale:.2f} mm a unit"
    elif options.tag_mm:
        scale = by_tags(shots, options.tag_mm, options.family)
        note = f"scale by the tags: {1000 * scale:.2f} mm a unit"
    else:
        raise DatasetError(
            "the scale of these poses is not known: give --unit-mm (1000 if they are in metres), --tag-mm if a board "
            "is in the photos, or --distance with two clicked points"
        )
    return [replace(shot, camera_from_world=scaled(shot.camera_from_world, scale)) for shot in shots], note


def scaled(pose: np.ndarray, scale: float) -> np.ndarray:
    out = pose.copy()
    out[:3, 3] *= scale
    return out


def from_robot(options: argparse.Namespace) -> Imported:
    """Camera poses by the flange's, and by the camera on it, which the tags tell if nobody else does."""
    if options.source is None:
        raise DatasetError("--poses: give the folder of photos, too")
    unit = (options.unit_mm or METRE_MM) / METRE_MM
    rows = read_rows(options.poses)
    notes, doubts = [], []
    if options.flange_from_camera:
        if options.camera is None:
            raise DatasetError("--poses: give --camera, or --tag-mm with a board in the photos")
        flange_from_camera = read_pose(options.flange_from_camera.split(), "--flange-from-camera")
        photo = open_photo(find_image([options.source], next(iter(rows)), str(options.poses)))
        camera = read_camera(options.camera).scaled(photo.width, photo.height)
    else:
        camera, flange_from_camera, note = by_the_board(rows, options, unit)
        notes.append(note)
    posed = read_robot(rows, flange_from_camera, camera, options.source)
    return Imported(open_all(posed, unit, options.max_px), [], notes, doubts)


def by_the_board(
    rows: dict[str, np.ndarray], options: argparse.Namespace, unit: float
) -> tuple[Camera, np.ndarray, str]:
    if options.tag_mm is None:
        raise DatasetError("--poses: give --flange-from-camera, or --tag-mm with a board in the photos")
    given = BoardOptions(options.tag_mm, camera=options.camera, family=options.family, max_px=options.max_px)
    with tempfile.TemporaryDirectory() as scratch:
        board = import_board(options.source, given, Path(scratch))
    both = [shot for shot in board.shots if shot.photo.name in rows]
    flange = np.stack([scaled(rows[shot.photo.name], unit) for shot in both]) if both else np.zeros((0, 4, 4))
    seen = np.array([shot.camera_from_world for shot in both]).reshape(-1, 4, 4)
    found, degrees, metres = hand_eye(flange, seen)
    if metres > MOVED_M and (k := board_moved(flange, seen)) is not None:
        raise DatasetError(
            f"--poses: the board was moved after {both[k - 1].photo.name} (before {both[k].photo.name}): two "
            "components. Give the rows before and after as two projects, or leave out the fewer"
        )
    found[:3, 3] /= unit
    note = (
        f"camera on the flange by {len(both)} photos with tags: the board seems to move by {degrees:.2f} degrees and "
        f"{1000 * metres:.2f} mm in the median"
    )
    return both[0].camera, found, note
