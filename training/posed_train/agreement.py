"""Looks at a dataset as a whole: boxes, masks, sizes and poses must agree with each other."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from .bop import DatasetError, View, read_mask
from .diagnose import OFF_BY_ONE, diagnose
from .midway import change, contrast
from .registration import Component
from .residual import Sights, middle, sights, whole
from .size import compare_size

LEAST_WHOLE = 8
"""Views of a component that show the object whole: fewer do not tell what is wrong."""
LOOKED_AT = 30
"""Masks."""
MASK_AGREES = 0.7
MOST_UNLIKE = 0.2
NAMED = 6


def image_sizes(views: Sequence[View]) -> np.ndarray:
    """`[V, 2]` width and height, pixels."""
    known: dict[Path, tuple[int, int]] = {}
    for view in views:
        if view.image_path not in known:
            try:
                with Image.open(view.image_path) as image:
                    known[view.image_path] = image.size
            except OSError:
                raise DatasetError(f"{view.image_path}: not a readable image") from None
    return np.array([known[view.image_path] for view in views], float)


def boxes_meet(views: Sequence[View], component: Component) -> tuple[list[str], Sights | None, list[int]]:
    """What is wrong with poses, boxes or camera parameters; and the views that show the object whole."""
    mine = [views[index] for index in component.views]
    sizes = image_sizes(mine)
    chosen = [k for k, view in enumerate(mine) if whole(view, tuple(sizes[k]))]
    if len(chosen) < LEAST_WHOLE:
        return [], None, []
    seen = sights([mine[k] for k in chosen], component.camera_from_component[chosen], sizes[chosen])
    names = [f"{mine[k].scene}/{mine[k].image_path.name}" for k in chosen]
    return diagnose(seen, names), seen, [component.views[k] for k in chosen]


def describe_meeting(seen: Sights) -> str:
    found = middle(seen)[1]
    return (
        f"boxes against poses: {np.median(found):.3f} of a box's side in the median, {found.max():.2f} at worst "
        f"({len(seen)} photos that show it whole)"
    )


def stands_still(views: Sequence[View], component: Component) -> list[str]:
    """What is wrong if masks show the object in some photos, in their order, and what it lies on in the others: masks
    that were found near where it should be lie there whether it does or not, and so do their boxes."""
    mine = [views[index] for index in component.views if views[index].mask_path is not None]
    values, shown = [], []
    for view in mine:
        mask = read_mask(view)
        image = cv2.imread(str(view.image_path), cv2.IMREAD_COLOR)
        if mask is None or image is None or mask.shape != image.shape[:2]:
            continue
        others = np.zeros_like(mask)
        for path in view.mask_path.parent.glob(f"{view.image_id:06d}_*.png"):
            other = None if path == view.mask_path else cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if other is not None and other.shape == mask.shape:
                others |= other
        value = contrast(image, mask, others)
        if value is not None:
            values.append(value)
            shown.append(f"{view.scene}/{view.image_path.name}")
    k = change(np.array(values))
    if k is None:
        return []
    before = np.median(values[:k]) > np.median(values[k:])
    there, gone = ("before", "from there on") if before else ("from there on", "before")
    return [
        f"the object, or the board beneath it, moved after photo {shown[k - 1]} (before {shown[k]}): {there} masks "
        f"show it, {gone} they show what it lay on: two components. Put the photos after it into a scene of their own "
        "(`posed-train new --to`, `posed-train add --from`)"
    ]


def masks_found(views: Sequence[View]) -> tuple[str, list[str]]:
    """How many views have a mask, and what is wrong with them."""
    found = [view for view in views if view.mask_path is not None]
    words, problems = f"masks: {len(found)} of {len(views)}", []
    if len(found) < len(views):
        by_scene: dict[tuple[str, str], list[View]] = defaultdict(list)
        for view in views:
            if view.mask_path is None:
                by_scene[view.split, view.scene].append(view)
        for (split, scene), without in by_scene.items():
            folder = Path(split) / scene / "mask_visib"
            there = sorted(folder.glob("*.png")) if folder.is_dir() else []
            if there:
                problems.append(
                    f"{folder}: {len(without)} masks are missing; it has {there[0].name}, but masks are named as "
                    f"{without[0].image_id:06d}_000000.png: the image's number and the object's place in scene_gt.json"
                )
    return words, problems + masks_readable(found) + masks_agree(found)


def masks_readable(views: Sequence[View]) -> list[str]:
    """A mask that cannot be read is none, and without one the net learns what is around the object."""
    bad = []
    for view, size in zip(views, image_sizes(views)):
        try:
            with Image.open(view.mask_path) as mask:
                good = mask.size == tuple(size)
        except OSError:
            good = False
        if not good:
            bad.append(f"{view.scene}/{view.mask_path.name}")
    if not bad:
        return []
    return [f"{len(bad)} masks cannot be read, or are not of their image's size: {', '.join(bad[:NAMED])}"]


def masks_agree(views: Sequence[View]) -> list[str]:
    some = [views[k] for k in np.unique(np.linspace(0, len(views) - 1, LOOKED_AT).astype(int))] if views else []
    unlike = [view for view in some if not mask_fits(view)]
    if len(unlike) <= MOST_UNLIKE * len(some):
        return []
    names = ", ".join(f"{view.scene}/{view.mask_path.name}" for view in unlike[:NAMED])
    return [
        f"{len(unlike)} of {len(some)} masks are not where the boxes are ({names}): masks or boxes are of other "
        "photos or objects"
    ]


def mask_fits(view: View) -> bool:
    mask = read_mask(view)
    if mask is None:
        return False
    x, y, w, h = cv2.boundingRect(mask)
    a, b = np.array([x, y, x + w, y + h]), np.array(view.box, float)
    b[2:] += b[:2]
    shared = np.prod(np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0))
    union = np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - shared
    return shared >= MASK_AGREES * union


def whose_order(problems: list[str], masks_wrong: bool) -> list[str]:
    """Of poses and boxes that are one photo off, masks tell which are the photo's own."""
    if not masks_wrong:
        return [
            problem.replace(OFF_BY_ONE, "the poses are one photo off (masks and boxes agree)") for problem in problems
        ]
    return [
        problem.replace(OFF_BY_ONE, "the boxes are one photo off (the masks disagree with them)")
        for problem in problems
    ]


def size_agrees(
    views: Sequence[View], seen: Sights, size_mm: Sequence[float], up: np.ndarray | None
) -> tuple[str, str]:
    """`views` are those of `seen`."""
    masks = [mask for view in views if (mask := read_mask(view)) is not None]
    return compare_size(seen, size_mm, masks if len(masks) == len(views) else (), up)


def rotations(views: Sequence[View], component: Component) -> list[str]:
    """Matrices that are none."""
    turn = component.camera_from_component[:, :3, :3]
    apart = np.abs(turn @ np.swapaxes(turn, 1, 2) - np.eye(3)).max((1, 2))
    bad = [views[component.views[k]] for k in np.flatnonzero((apart > 0.02) | (np.linalg.det(turn) < 0))]
    if not bad:
        return []
    names = ", ".join(view.image_path.name for view in bad[:NAMED])
    return [f"{len(bad)} camera rotations are none (rows of length 1 at right angles, not mirrored): {names}"]
