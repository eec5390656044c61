"""Every photo's masks of the objects of one scene, from boxes that were drawn in a few photos.

An upright solid is fitted to the boxes. Then two ways are tried on some photos, and the one whose masks agree better
with the drawn boxes is used on all: (a) GrabCut near the solid's own outline, right for boxes and cylinders, also where
a white face vanishes before a white board; (b) GrabCut within the carved boxes, a visual hull by votes, GrabCut near
the hull's outline, right for all other shapes.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..bop import DatasetError
from . import hull as voxels
from .drawn import Drawn
from .grabcut import Window, band, overlap, segment
from .hull import Hull
from .project import SOLIDS
from .solid import Frame, Solid, bounds, fill, fit, silhouette

SAMPLE = 30
"""Photos that the shape is found from."""
CLEARLY = 0.015
"""Of IoU."""
FITS = 0.015
"""A solid whose bounds are this close to the masks' boxes, of their side, is the object's shape."""
TOLD = 4
"""Photos that a 3D box that was told is held to, as if boxes had been drawn."""
BAND_OF_SOLID = 0.07
BAND_OF_HULL = 0.06
CORE = 0.5
"""Of the solid: surely the object."""
OUTER_SLACK, OUTER_SLACK_PX = 0.02, 3.0
LEAST_AGREEMENT = 0.7
"""Of a mask with the shape's outline: below it, the outline is better."""
LEAST_TO_MEASURE = 8
MAX_OFF_PX = 0.15
"""Of a drawn box's side: beyond, the boxes are not of one still object."""


@dataclass(frozen=True)
class Shape:
    """What is known of an object, to be looked for in each photo."""

    solid: Solid
    hull: Hull | None
    agreement: float
    """IoU of the masks' boxes with the drawn ones."""
    consistency: float
    """IoU of the masks with the shape's own outlines."""

    def project(self, frame: Frame, window: Window) -> np.ndarray:
        if self.hull is not None:
            return self.hull.project(frame, window)
        return fill(window.to_window(silhouette(self.solid, frame)), *window.size)

    @property
    def uncertain(self) -> float:
        return BAND_OF_SOLID if self.hull is None else BAND_OF_HULL


def window_of(solid: Solid, frame: Frame) -> Window | None:
    if frame.depth(solid.centre) < solid.size.max() / 2:
        return None
    return Window.around(silhouette(solid, frame), frame.width, frame.height)


def fit_solid(drawn: Drawn, frames: Sequence[Frame], grounded: bool, name: str) -> Solid:
    if drawn.solid is not None:
        return drawn.solid
    boxes = drawn.in_frames(list(frames))
    solid, off = min(
        (fit(boxes, kind, grounded) for kind in ([drawn.kind] if drawn.kind else SOLIDS)), key=lambda found: found[1]
    )
    allowed = MAX_OFF_PX * float(np.mean([(box[2:] - box[:2]).max() for _, box in boxes]))
    if off > allowed:
        raise DatasetError(
            f"{name}: no solid fits the drawn boxes (edges {off:.0f} px off in the mean): is one of them of another "
            "object, or did the object move?"
        )
    return solid


def spread(frames: Sequence[Frame], solid: Solid, count: int) -> list[Frame]:
    """Some photos that show the whole solid, from directions as different as can be."""
    whole = []
    for frame in frames:
        outline = silhouette(solid, frame)
        inside = (outline.min(0) >= 0).all() and (outline.max(0) <= [frame.width - 1, frame.height - 1]).all()
        if inside and frame.depth(solid.centre) > 0:
            whole.append(frame)
    if len(whole) <= count:
        return whole
    towards = np.stack([solid.centre + f.camera_from_standing[:3, :3].T @ f.camera_from_standing[:3, 3] for f in whole])
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    chosen = [0]
    nearest = towards @ towards[0]
    while len(chosen) < count:
        chosen.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, towards @ towards[chosen[-1]])
    return [whole[k] for k in sorted(chosen)]


Seen = tuple[Frame, Window, np.ndarray]
Read = Callable[[Frame], np.ndarray]


def look(
    frames: Sequence[Frame], read: Read, solid: Solid, regions: Callable[[Frame, Window], tuple[np.ndarray, ...]]
) -> list[Seen]:
    """The masks that GrabCut finds between each photo's regions (inside, outside, likely)."""

    def one(frame: Frame) -> Seen | None:
        window = window_of(solid, frame)
        if window is None:
            return None
        mask = segment(window.cut(read(frame)), *regions(frame, window), seed=frame.image_id)
        return None if mask is None else (frame, window, mask)

    with ThreadPoolExecutor() as pool:
        return [seen for seen in pool.map(one, frames) if seen is not None]


def near_outline(project: Callable[[Frame, Window], np.ndarray], uncertain: float):
    def regions(frame: Frame, window: Window) -> tuple[np.ndarray, ...]:
        outline = project(frame, window)
        return (*band(outline, uncertain), outline)

    return regions


def find_shape(drawn: Drawn, solid: Solid, frames: Sequence[Frame], read: Read) -> Shape:
    """By the best of the ways."""
    sample = spread(frames, solid, SAMPLE)
    boxes = drawn.in_frames(list(frames)) or [(frame, bounds(solid, frame)) for frame in spread(frames, solid, TOLD)]
    judged = [frame for frame, _ in boxes]
    judged += [frame for frame in sample[::3] if frame.image_id not in {one.image_id for one in judged}]
    plain = Shape(solid, None, 0, 0)
    shape = judge(plain, look(judged, read, solid, near_outline(plain.project, BAND_OF_SOLID)), boxes)
    for hull, cramped in find_hulls(boxes, solid, [*sample, *judged], read):
        other = Shape(voxels.around(hull, solid), hull, 0, 0)
        seen = look(judged, read, other.solid, near_outline(hull.project, BAND_OF_HULL))
        shape = better(shape, judge(other, seen, boxes))
        if shape.hull is not hull or not cramped:  # a hull that the solid is better than need not be a larger one
            break
    return shape


def better(simple: Shape, other: Shape) -> Shape:
    """Drawn boxes are a pixel or two off: where they do not tell, the colours do, which follow the right outline."""
    alike = other.agreement > simple.agreement - CLEARLY
    more = other.agreement > simple.agreement + CLEARLY
    return other if more or (alike and other.consistency > simple.consistency + CLEARLY) else simple


def judge(shape: Shape, seen: list[Seen], boxes: list[tuple[Frame, np.ndarray]]) -> Shape:
    alike = [overlap(mask, shape.project(frame, window)) for frame, window, mask in seen]
    return replace(shape, agreement=agreement(seen, boxes), consistency=float(np.median(alike)) if alike else 0.0)


def find_hulls(
    boxes: list[tuple[Frame, np.ndarray]], solid: Solid, sample: Sequence[Frame], read: Read
) -> Iterator[tuple[Hull, bool]]:
    """One found near the solid; then one found in all that the boxes leave room for. And whether it has too little."""
    sample = list({frame.image_id: frame for frame in sample}.values())
    for outer, sides in voxels.rooms(solid, lambda points: voxels.carve(points, boxes, OUTER_SLACK, OUTER_SLACK_PX)):
        hull = find_hull_within(outer, solid, sample, read)
        if hull is not None:
            yield hull, voxels.is_cramped(hull, solid, sides)


def find_hull_within(outer: Hull, solid: Solid, sample: Sequence[Frame], read: Read) -> Hull | None:
    core, whole = solid.scaled(CORE), voxels.larger(solid, outer)

    def carved(frame: Frame, window: Window) -> tuple[np.ndarray, ...]:
        may = outer.project(frame, window)
        surely = fill(window.to_window(silhouette(core, frame)), *window.size) & may
        return surely, 255 - may, may

    seen = look(sample, read, whole, carved)
    for last in (False, True):
        if not seen:
            return None
        hull = voxels.consensus(outer.points, outer.pitch, seen)
        if not len(hull.points):
            return None
        if not last:
            seen = look(sample, read, voxels.around(hull, solid), near_outline(hull.project, BAND_OF_HULL))
    return hull


def agreement(seen: list[Seen], boxes: list[tuple[Frame, np.ndarray]]) -> float:
    """Mean IoU of the masks' boxes with the drawn ones."""
    masks = {frame.image_id: (window, mask) for frame, window, mask in seen}
    scores = []
    for frame, box in boxes:
        if frame.image_id not in masks:
            scores.append(0.0)
            continue
        window, mask = masks[frame.image_id]
        x, y, w, h = cv2.boundingRect(window.paste(mask, frame.width, frame.height))
        scores.append(box_overlap(np.array([x, y, x + w - 1, y + h - 1]), box))
    return float(np.mean(scores)) if scores else 0.0


def box_overlap(a: np.ndarray, b: np.ndarray) -> float:
    """IoU of left, top, right, bottom, the last ones included."""
    low, high = np.maximum(a[:2], b[:2]), np.minimum(a[2:], b[2:])
    shared = np.prod(np.maximum(high - low + 1, 0))
    return float(shared / (np.prod(a[2:] - a[:2] + 1) + np.prod(b[2:] - b[:2] + 1) - shared))


@dataclass(frozen=True)
class Label:
    """One object in one photo."""

    mask: np.ndarray  # [H, W] 0 or 255: what is seen of it
    visible: float
    """Share of its outline that is in the photo and behind no other object."""
    agreement: float
    """IoU of the mask with the outline that was expected."""
    contrast: float | None = None
    """How unlike its colours are to those around it, if that was looked at."""

    @property
    def box(self) -> tuple[int, int, int, int]:
        """x, y, w, h."""
        return cv2.boundingRect(self.mask)


def label_photo(frame: Frame, image: np.ndarray, shapes: Sequence[Shape]) -> list[Label]:
    """All objects of one photo, the nearest first: it hides parts of the others."""
    empty = np.zeros((frame.height, frame.width), np.uint8)
    labels, taken = [Label(empty, 0.0, 0.0)] * len(shapes), empty
    for index in sorted(range(len(shapes)), key=lambda k: frame.depth(shapes[k].solid.centre)):
        shape = shapes[index]
        window = window_of(shape.solid, frame)
        if window is None:
            continue
        blocked = (window.cut(taken) > 127) * np.uint8(255)
        expected = shape.project(frame, window)
        free = expected & ~blocked
        visible = min(1.0, float((free > 0).sum()) / whole_area(shape, frame, window))
        inside, outside = band(expected, shape.uncertain)
        mask = None
        if free.any():
            mask = segment(window.cut(image), inside & ~blocked, outside | blocked, free, frame.image_id)
        alike = 0.0 if mask is None else overlap(mask, free)
        if alike < LEAST_AGREEMENT:
            mask = free
        whole = window.paste(mask, frame.width, frame.height)
        labels[index] = Label(whole, visible, alike)
        taken = taken | whole
    return labels


def whole_area(shape: Shape, frame: Frame, window: Window) -> float:
    """Pixels at the window's scale, with what lies beyond the photo's borders and behind others."""
    outline = silhouette(shape.solid, frame)
    low, high = np.floor(outline.min(0) - 2), np.ceil(outline.max(0) + 2)
    low, high = np.maximum(low, -4 * frame.width), np.minimum(high, 5 * frame.width)
    unlimited = Window(*low.astype(int), *high.astype(int), window.scale)
    return max(1.0, float((shape.project(frame, unlimited) > 0).sum()))


def measure(shape: Shape, frames: Sequence[Frame], labels: Sequence[Label], grounded: bool) -> Solid:
    """The object's box by the boxes of all masks that show it whole: three boxes drawn by hand tell its size less well.
    What is neither a box nor a cylinder is measured by its hull."""
    good = []
    for frame, label in zip(frames, labels):
        x, y, w, h = label.box
        if label.visible > 0.98 and label.agreement > 0.85:
            good.append((frame, np.array([x, y, x + w - 1, y + h - 1], float)))
    if len(good) < LEAST_TO_MEASURE:
        return shape.solid
    solid, off = fit(good, shape.solid.kind, grounded, start=shape.solid)
    side = float(np.median([(box[2:] - box[:2]).max() for _, box in good]))
    return shape.solid if shape.hull is not None and off > FITS * side else solid
