"""`posed-train new`: photos and camera poses become a project."""

import json
import tempfile
from pathlib import Path

import cv2
import numpy as np

from ..bop import DatasetError
from ..rays import nearest_point, upwards
from .coverage import Coverage, coverage, draw_coverage, draw_sheet, table, thumbnail
from .from_board import UP_FROM_BOARD, BoardOptions, Imported, import_board
from .from_bop import copy_labels, read_bop
from .project import SPLIT, create, load, new_folder
from .scene import write_scene

LEAST_SHOTS = 8
MAX_DOUBTS_SHOWN = 20
UP_IS_GUESSED = (
    "up is guessed from how the photos were held; if the heights are wrong, give up = [x, y, z] under [[photos]] in "
    "object.toml"
)


def new_from_board(folder: Path, names: list[str], source: Path, options: BoardOptions) -> str:
    """Makes the project; returns what to print."""
    project = create(folder, names)
    with tempfile.TemporaryDirectory(prefix="posed-frames-") as scratch:
        imported = import_board(source, options, Path(scratch))
        if len(imported.shots) < LEAST_SHOTS:
            raise DatasetError("\n  ".join([too_few(imported), *imported.doubts[:MAX_DOUBTS_SHOWN]]))
        project.sources.append({"scene": "000000", "source": str(source), "by": "board", "tag_mm": options.tag_mm})
        with new_folder(folder) as part:
            text = fill(part, imported, "000000")
            project.folder = part
            project.save()
    return text


def add_from_board(folder: Path, source: Path, options: BoardOptions) -> tuple[str, str]:
    """More photos of a project's objects, on a board again, as a scene of their own: the scene and what to print."""
    project = load(folder)
    names = (
        [int(scene.name) for scene in project.split.iterdir() if scene.name.isdigit()] if project.split.is_dir() else []
    )
    scene = f"{max(names, default=-1) + 1:06d}"
    with tempfile.TemporaryDirectory(prefix="posed-frames-") as scratch:
        imported = import_board(source, options, Path(scratch))
        if len(imported.shots) < LEAST_SHOTS:
            raise DatasetError("\n  ".join([too_few(imported), *imported.doubts[:MAX_DOUBTS_SHOWN]]))
        project.sources.append({"scene": scene, "source": str(source), "by": "board", "tag_mm": options.tag_mm})
        with new_folder(project.split / scene) as part:
            write_scene(imported.shots, part / "scene")
            for path in (part / "scene").iterdir():
                path.rename(part / path.name)
            (part / "scene").rmdir()
        project.save()
    return scene, show(folder, imported, scene)


def new_from_poses(folder: Path, names: list[str], imported: list[Imported], source: dict) -> str:
    """Of photos that have poses already, a scene for each of `imported`."""
    project = create(folder, names)
    if sum(len(scene.shots) for scene in imported) < LEAST_SHOTS:
        raise DatasetError(too_few(imported[0]))
    with new_folder(folder) as part:
        texts = add_scenes(part, imported)
        project.sources += [{"scene": f"{k:06d}"} | source for k in range(len(imported))]
        project.folder = part
        project.save()
    return texts


def add_scenes(folder: Path, imported: list[Imported]) -> str:
    if len(imported) == 1:
        return fill(folder, imported[0], "000000")
    for number, scene in enumerate(imported):
        write_scene(scene.shots, folder / SPLIT / f"{number:06d}")
    count = f"{sum(len(scene.shots) for scene in imported)} photos in {len(imported)} components"
    return "\n".join([count, *(note for scene in imported for note in scene.notes)])


def new_from_bop(folder: Path, names: list[str], source: Path) -> str:
    """With the boxes, masks and poses of as many objects as names are given, in the order of their numbers."""
    scenes = read_bop(source)
    ids = sorted(set().union(*(scene.obj_ids for scene in scenes)))
    project = create(folder, names)
    if ids and len(ids) != len(project.items):
        raise DatasetError(f"{source} has objects {', '.join(map(str, ids))}: give as many names with --objects")
    new_ids = dict(zip(ids, (item.obj_id for item in project.items)))
    imported = [Imported(scene.shots, []) for scene in scenes]
    with new_folder(folder) as part:
        text = add_scenes(part, imported)
        for number, scene in enumerate(scenes):
            copy_labels(scene, part / SPLIT / f"{number:06d}", new_ids)
        project.sources += [{"scene": f"{k:06d}", "source": str(source), "by": "bop"} for k in range(len(scenes))]
        project.folder = part
        project.save()
    return text


def too_few(imported: Imported) -> str:
    return f"{len(imported.shots)} photos have a camera pose; {LEAST_SHOTS} are the least, 60 to 200 learn well"


def fill(folder: Path, imported: Imported, scene: str) -> str:
    """Writes a scene and its pictures; returns what to print."""
    write_scene(imported.shots, folder / SPLIT / scene)
    if imported.camera is not None:
        (folder / "camera.json").write_text(json.dumps(imported.camera.as_dict(), indent=2) + "\n")
    return show(folder, imported, scene)


def show(folder: Path, imported: Imported, scene: str) -> str:
    """Draws a scene's pictures; returns what to print."""
    seen = look_from(imported)
    pictures = folder / "pictures"
    pictures.mkdir(exist_ok=True)
    draw_coverage(seen, pictures / f"coverage-{scene}.png")
    doubtful = {doubt.split(":")[0] for doubt in imported.doubts}
    images = [(folder / SPLIT / scene / "rgb" / f"{k:06d}") for k in range(len(imported.shots))]
    draw_sheet(
        [
            thumbnail(read_small(path), shot.photo.name, shot.photo.name in doubtful)
            for path, shot in zip(images, imported.shots)
        ],
        pictures / f"photos-{scene}.jpg",
    )
    notes = imported.notes if imported.board is not None else [*imported.notes, UP_IS_GUESSED]
    return "\n".join([table(imported.rows, seen), *notes, *doubts(imported.doubts), *where_to_go(seen)])


def read_small(stem: Path) -> np.ndarray:
    path = next(path for suffix in (".jpg", ".png") if (path := stem.with_suffix(suffix)).exists())
    return cv2.imread(str(path), cv2.IMREAD_REDUCED_COLOR_4)


def look_from(imported: Imported) -> Coverage:
    """Around the middle of the board, or, without one, around the point that the cameras look at."""
    poses = [shot.camera_from_world for shot in imported.shots]
    if imported.board is not None:
        centre = np.append(np.mean([corners.mean(0) for corners in imported.board.corners.values()], axis=0), 0)
        return coverage(poses, centre, UP_FROM_BOARD)
    stacked = np.stack(poses)
    axes, origins = stacked[:, 2, :3], -np.einsum("vji,vj->vi", stacked[:, :3, :3], stacked[:, :3, 3])
    centre = nearest_point(origins, axes)
    return coverage(poses, centre, upwards(stacked))


def doubts(found: list[str]) -> list[str]:
    if not found:
        return ["no doubtful photos"]
    more = [f"  ... and {len(found) - MAX_DOUBTS_SHOWN} more"] if len(found) > MAX_DOUBTS_SHOWN else []
    return [f"doubtful photos ({len(found)}):", *(f"  {doubt}" for doubt in found[:MAX_DOUBTS_SHOWN]), *more]


def where_to_go(seen: Coverage) -> list[str]:
    low = sum(elevation < 30 for _, elevation in seen.missing())
    gaps = len(seen.missing())
    if not gaps:
        return []
    return [f"{gaps} of the directions have no photo, {low} of them low ones: see pictures/coverage-*.png"]
