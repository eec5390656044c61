"""`posed-train check` of a project."""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..bop import DatasetError, read_views
from ..check import check
from ..size import parse_size
from . import project as projects
from .new import UP_FROM_BOARD
from .project import Project
from .scene import photo_names

IMAGE = re.compile(r"\b([\w-]+)/(\d{6})\.(?:jpg|png)\b")
MOST_DISPROPORTION = 1.35
"""Boxes that are placed by eye are a tenth off, a side."""
MIN_VISIBLE = 0.35
"""As in training."""


def check_project(folder: Path, name: str | None, size: str | None) -> None:
    """Prints what it finds, and at the end "passed" or what to do; exits with 1 in that case."""
    project = projects.load(folder)
    items = [project.item(name)] if name else project.items
    if size and len(items) > 1:
        raise DatasetError(f"--size-mm: the project has {len(items)} objects; say which one with --object")
    problems = unfinished(project)
    for item in items:
        expected = parse_size(size) if size else (tuple(item.size_mm) or None)
        try:
            views = read_views(project.split, item.obj_id, MIN_VISIBLE)
        except DatasetError as error:
            if "no usable view" in str(error):
                raise DatasetError(f"{item.name} has no boxes yet: `posed-train label {folder}`") from None
            raise
        report = check(views, "camera", expected, up(project))
        print(f"{item.name}: {report}")
        if size and item.size_mm:
            problems += [f"{item.name}: {problem}" for problem in out_of_proportion(item.size_mm, expected)]
        problems += [f"{item.name}: {by_photo_names(problem, project)}" for problem in report.problems]
    conclude(problems)


def out_of_proportion(labelled: Sequence[float], stated: Sequence[float]) -> list[str]:
    """What is wrong with a box's sides, whatever the scale. In order of their length: the box's frame is its own."""
    ratios = np.sort(labelled) / np.sort(stated)
    if ratios.max() / ratios.min() <= MOST_DISPROPORTION:
        return []
    box, ruler = (" x ".join(f"{side:g}" for side in sorted(sides)) for sides in (labelled, stated))
    return [f"its box was placed as {box} mm, which is another shape than {ruler} mm: which of the two is wrong?"]


def by_photo_names(text: str, project: Project) -> str:
    """With the photos' own names, which commands take, instead of the images'."""
    names = {scene.name: photo_names(scene) for scene in project.scenes}

    def named(found: re.Match) -> str:
        return names.get(found[1], {}).get(int(found[2]), found[0])

    return IMAGE.sub(named, text)


def up(project: Project) -> np.ndarray | None:
    """Away from the board, where all scenes are on boards."""
    return UP_FROM_BOARD if project.sources and all(s.get("by") == "board" for s in project.sources) else None


def unfinished(project: Project) -> list[str]:
    if not project.split.is_dir():
        raise DatasetError(f"{project.split}: missing; a project has its scenes there")
    whole = {scene.name for scene in project.scenes}
    return [
        f"{scene} has images, but no scene_gt_info.json: it is not used"
        for scene in sorted(project.split.iterdir())
        if (scene / "rgb").is_dir() and scene.name not in whole
    ]


def conclude(problems: list[str]) -> None:
    if not problems:
        print("passed")
        return
    print(f"not passed; to do ({len(problems)}):")
    for number, problem in enumerate(problems, 1):
        print(f"  {number}. {problem}")
    sys.exit(1)
