"""`posed-train label --coco` and its like: boxes and masks that exist become a project's.

Where the boxes tell a 3D box, as they do of an object that stands still, it becomes the object's frame and size; and
where there are boxes alone, it and the colours tell masks.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from ..bop import DatasetError
from ..residual import BORDER_PX, USUAL, Sights, typical
from . import project as projects
from .drawn import Drawn
from .given import Given
from .label import Scene, draw_labels, read_image, read_scene, source_of
from .labels import LEAST_BOX_PX, Entry, box_of, write_entries
from .originals import Original, read_originals
from .outlines import Label, box_overlap, find_shape, fit_solid, label_photo
from .photos import listed
from .project import Item, Project
from .solid import Frame, Solid, bounds

LEAST_WHOLE = 8
"""Boxes of a whole object: fewer do not tell whether they fit the camera poses."""
FITTED = 30
"""Boxes that a 3D box is fitted to."""
FITS_AGAIN = 0.5
"""A mistake is what it is if mended boxes are off by less than this share of what they were."""
MASK_FITS_BOX = 0.5


@dataclass(frozen=True)
class Placed:
    """A label with the photo of the project that it is of."""

    given: Given
    frame: Frame
    original: Original | None
    """None where the label is of the project's own image."""

    def in_image(self, stored: bool, turned=None) -> np.ndarray:
        """Left, top, right, bottom edges in the project's image; pixel (0, 0) reaches from 0 to 1."""
        width, height = self.size(stored)
        left, top, right, bottom = self.given.box * ([1] * 4 if self.given.size else [width, height] * 2)
        steps = np.linspace(0, 1, 9)
        across, down = left + (right - left) * steps, top + (bottom - top) * steps
        rim = [np.column_stack([across, np.full(9, y)]) for y in (top, bottom)]
        rim += [np.column_stack([np.full(9, x), down]) for x in (left, right)]
        points = np.concatenate(rim)
        if turned is not None:
            points = turned(points, width, height)
        if self.original is not None:
            points = self.original.points(points - 0.5, upright=not self.is_stored(stored)) + 0.5
        limits = [self.frame.width, self.frame.height]
        return np.concatenate([np.clip(points.min(0), 0, limits), np.clip(points.max(0), 0, limits)])

    def is_stored(self, stored: bool) -> bool:
        """Whether the label is of the photo as it is stored; `stored` is taken where sizes do not tell."""
        if self.original is None or self.given.size is None:
            return stored
        sizes = (self.original.width, self.original.height), self.original.upright_size
        return stored if sizes[0] == sizes[1] else self.given.size == sizes[0]

    def size(self, stored: bool) -> tuple[int, int]:
        if self.given.size is not None:
            return self.given.size
        if self.original is None:
            return self.frame.width, self.frame.height
        original = self.original
        return (original.width, original.height) if stored else original.upright_size

    def mask(self, stored: bool) -> np.ndarray | None:
        if self.given.mask is None:
            return None
        mask = self.given.mask(*self.size(stored))
        return mask if self.original is None else self.original.mask(mask, upright=not self.is_stored(stored))


def import_labels(folder: Path, found: Sequence[Given], categories: Mapping[str, str]) -> str:
    """`categories`: of the file, by which name the project knows them. Returns what to print."""
    project = projects.load(folder)
    by_item, notes = by_object(project, found, categories)
    scenes = [read_scene(path, source_of(project, path.name)) for path in project.scenes]
    placed, unknown = match(scenes, [one for mine in by_item.values() for one in mine])
    if unknown:
        notes.append(f"{len(unknown)} images are not in the project (or have no camera pose): {listed(unknown)}")
    # All is read and checked before anything is written.
    work = []
    for scene in scenes:
        for name, given in by_item.items():
            mine = [placed[id(one)] for one in given if id(one) in placed and placed[id(one)].frame in scene.frames]
            if mine:
                work.append((scene, project.item(name), labelled(project, scene, project.item(name), mine, notes)))
    if not work:
        raise DatasetError("no label of an object in a photo of the project: nothing to import")
    for scene, item, (rows, solid) in work:
        write_entries(scene.folder, rows, of={item.obj_id})
        if solid is not None:
            solid.describe(item)
    project.save()
    draw(project, work)
    texts = [in_words(scene, item, rows, solid, several=len(scenes) > 1) for scene, item, (rows, solid) in work]
    return "\n".join([*texts, *notes])


def by_object(
    project: Project, found: Sequence[Given], categories: Mapping[str, str]
) -> tuple[dict[str, list[Given]], list[str]]:
    """Labels by the object's name; and which categories are none of the project's."""
    counts = Counter(one.category for one in found)
    for category, name in categories.items():
        if category not in counts:
            raise DatasetError(f"--category {category}={name}: no label has that category; there are {listed(counts)}")
        project.item(name)
    known = {item.name: item.name for item in project.items} | dict(categories)
    by_item: dict[str, list[Given]] = defaultdict(list)
    for one in found:
        if one.category in known:
            by_item[known[one.category]].append(one)
    others = {category: count for category, count in counts.items() if category not in known}
    if not by_item:
        names = ", ".join(item.name for item in project.items)
        raise DatasetError(
            f"no label is of the project's objects ({names}); its categories are {listed(others)}: say which is which "
            f'with --category "{next(iter(others), "CATEGORY")}={project.items[0].name}"'
        )
    return dict(by_item), [f"not taken, for the project has no such object: {listed(others)}"] if others else []


def match(scenes: Sequence[Scene], found: Sequence[Given]) -> tuple[dict[int, Placed], list[str]]:
    """The photo of each label, by the label's id; and images that are none of the project's."""
    photos: dict[str, list[tuple[Frame, Original | None]]] = defaultdict(list)
    files: dict[str, list[tuple[Frame, None]]] = defaultdict(list)
    for scene in scenes:
        originals = read_originals(scene.folder)
        for frame in scene.frames:
            for name in {frame.name, Path(frame.name).stem}:
                photos[name].append((frame, originals.get(frame.image_id)))
            for name in (frame.path.name, frame.path.stem):
                files[name].append((frame, None))
                files[f"{scene.folder.name}/{name}"].append((frame, None))
    placed, unknown, seen = {}, [], {}
    for one in found:
        path = PurePosixPath(one.image.replace("\\", "/"))
        with_scene = "/".join([part for part in path.parts if part != "rgb"][-2:])
        names = [(photos, one.image), (photos, path.name), (files, with_scene), (files, path.name)]
        candidates = next((known[name] for known, name in names if name in known), [])
        if not candidates:
            unknown.append(one.image)
            continue
        if len({frame.path for frame, _ in candidates}) > 1:
            raise DatasetError(
                f"{one.where}: several photos of the project are named {one.image}; name the project's image: "
                f"{' or '.join(f'{frame.path.parts[-3]}/{frame.path.name}' for frame, _ in candidates)}"
            )
        place = Placed(one, *candidates[0])
        check_size(place)
        twice = seen.setdefault((place.frame.path, one.category), one)
        if twice is not one:
            raise DatasetError(
                f"{one.where}: {one.image} has {one.category} twice (also {twice.where}): a photo may show an object "
                "once, for nothing tells its copies apart; take one of them away"
            )
        placed[id(one)] = place
    if not placed:
        raise DatasetError(f"no image of these labels is in the project: {listed(unknown)}")
    return placed, unknown


def check_size(place: Placed) -> None:
    given, original = place.given, place.original
    right = {(place.frame.width, place.frame.height)}
    if original is not None:
        right = {(original.width, original.height), original.upright_size}
    if given.size is None or given.size in right:
        return
    sizes = " or ".join(f"{width}x{height}" for width, height in sorted(right))
    width, height = given.size
    hint = "labels of a photo that was resized or cropped; label the photos themselves"
    if (height, width) in right:
        hint = "labels of a photo that was turned by 90 degrees; label it as it is stored or upright"
    raise DatasetError(f"{given.where}: {given.image} has {width}x{height} px there, the photo has {sizes}: {hint}")


def labelled(
    project: Project, scene: Scene, item: Item, placed: Sequence[Placed], notes: list[str]
) -> tuple[dict[int, list[Entry]], Solid | None]:
    """One object's labels in one scene, by image, and the 3D box that they tell."""
    stored = whose_pixels(item, placed)
    boxes = {place.frame.image_id: place.in_image(stored) for place in placed}
    seen = {place.frame.image_id: place for place in placed if size_of(boxes[place.frame.image_id]) >= LEAST_BOX_PX}
    frames = {frame.image_id: frame for frame in scene.frames}
    solid = fitted(scene, item, [(frames[key], boxes[key]) for key in seen], notes)
    with ThreadPoolExecutor() as pool:
        masks = dict(zip(seen, pool.map(lambda place: place.mask(stored), seen.values())))
    if solid is not None and any(mask is None for mask in masks.values()):
        masks |= by_colours(scene, solid, {key: boxes[key] for key, mask in masks.items() if mask is None})
    if any(mask is None for mask in masks.values()):
        notes.append(f"{item.name}: boxes without masks: the net may learn the scene with the object; give masks, too")
    first = scene.folder == project.scenes[0]
    rows = {}
    for key in seen:
        frame, mask = frames[key], masks[key]
        box = [*boxes[key][:2], *(boxes[key][2:] - boxes[key][:2])]
        given_mask = seen[key].given.mask is not None
        if given_mask:
            box = box_of(mask)
        pose = frame.camera_from_standing @ solid.standing_from_object(item) if solid is not None and first else None
        rows[key] = [Entry(item.obj_id, box, visible(box, solid, frame), mask, pose)]
    return rows, solid


def size_of(edges: np.ndarray) -> float:
    return float((edges[2:] - edges[:2]).min())


def visible(box: Sequence[float], solid: Solid | None, frame: Frame) -> float:
    """About the share of it that is seen: of its whole outline's box, if that is known."""
    if solid is None:
        return 1.0
    left, top, right, bottom = bounds(solid, frame)
    whole = max((right - left + 1) * (bottom - top + 1), 1.0)
    return float(np.clip(box[2] * box[3] / whole, 0.01, 1.0))


def whose_pixels(item: Item, placed: Sequence[Placed]) -> bool:
    """Whether labels are of the photos as they are stored, not as they are held; and refuses those of mirrored ones."""
    turned = [place for place in placed if place.original is not None and place.original.orientation != 1]
    ways = {stored: residual(placed, stored) for stored in ((False, True) if turned else (False,))}
    stored = min(ways, key=lambda way: ways[way])
    if not USUAL < ways[stored] < np.inf:
        return stored
    for name, change in MISTAKES.items():
        if residual(placed, stored, change) < min(USUAL, FITS_AGAIN * ways[stored]):
            raise DatasetError(
                f"{item.name}: the labels are of {name} images: so turned, they fit the camera poses. Label the photos "
                "as they are, or turn the labels back"
            )
    return stored


MISTAKES = {
    "mirrored": lambda points, width, height: points * [-1, 1] + [width, 0],
    "upside-down": lambda points, width, height: points * [-1, -1] + [width, height],
    "vertically mirrored": lambda points, width, height: points * [1, -1] + [0, height],
}


def residual(placed: Sequence[Placed], stored: bool, turned=None) -> float:
    """How far boxes lie from where the camera poses put the object's middle, by their side; infinite if few tell."""
    chosen = []
    for place in placed:
        left, top, right, bottom = place.in_image(stored, turned)
        inside = left > BORDER_PX and top > BORDER_PX
        inside &= right < place.frame.width - BORDER_PX and bottom < place.frame.height - BORDER_PX
        if inside and min(right - left, bottom - top) >= LEAST_BOX_PX:
            chosen.append((place.frame, [left, top, right - left, bottom - top]))
    if len(chosen) < LEAST_WHOLE:
        return np.inf
    frames, boxes = zip(*chosen)
    seen = Sights(
        np.stack([frame.matrix for frame in frames]),
        np.stack([frame.camera_from_standing for frame in frames]),
        np.array(boxes),
        np.array([[frame.width, frame.height] for frame in frames], float),
    )
    return typical(seen)


def fitted(scene: Scene, item: Item, boxes: Sequence[tuple[Frame, np.ndarray]], notes: list[str]) -> Solid | None:
    """The upright box or cylinder whose outlines have these boxes."""
    some = list(boxes)[:: -(-len(boxes) // FITTED)]
    drawn = Drawn(None, {frame.name: edges - [0, 0, 1, 1] for frame, edges in some})
    try:
        return fit_solid(drawn, [frame for frame, _ in some], scene.grounded, item.name)
    except DatasetError as error:
        where = f"scene {scene.folder.name}"
        notes.append(f"{item.name}: {where}: no 3D box fits the boxes ({error}); run `posed-train check`")
        return None


def by_colours(scene: Scene, solid: Solid, boxes: Mapping[int, np.ndarray]) -> dict[int, np.ndarray | None]:
    """Masks within boxes, by image; none where the colours tell another outline."""
    frames = [frame for frame in scene.frames if frame.image_id in boxes]
    edges = {frame.name: boxes[frame.image_id] - [0, 0, 1, 1] for frame in frames}
    some = dict(list(edges.items())[:: -(-len(edges) // FITTED)])
    shape = find_shape(Drawn(solid.kind, some), solid, frames, read_image)

    def one(frame: Frame) -> np.ndarray | None:
        (label,) = label_photo(frame, read_image(frame), [shape])
        x, y, w, h = label.box
        fits = w and box_overlap(np.array([x, y, x + w - 1, y + h - 1]), edges[frame.name]) >= MASK_FITS_BOX
        return label.mask if fits else None

    with ThreadPoolExecutor() as pool:
        return {frame.image_id: mask for frame, mask in zip(frames, pool.map(one, frames))}


def draw(project: Project, work: Sequence[tuple[Scene, Item, tuple]]) -> None:
    """The sheet of each scene, as after `label --box`."""
    for scene in {id(scene): scene for scene, _, _ in work}.values():
        rows = [rows for other, _, (rows, _) in work if other is scene]
        labels = [[as_label(frame, of.get(frame.image_id)) for of in rows] for frame in scene.frames]
        draw_labels(scene.frames, labels, project.folder / "pictures" / f"labels-{scene.folder.name}.jpg")


def as_label(frame: Frame, entries: Sequence[Entry] | None) -> Label:
    mask = np.zeros((frame.height, frame.width), np.uint8)
    if not entries:
        return Label(mask, 0.0, 0.0)
    (entry,) = entries
    if entry.mask is not None:
        return Label(entry.mask, entry.visible, 1.0)
    x, y, w, h = np.round(entry.box).astype(int)
    mask[y : y + h, x : x + w] = 255
    return Label(mask, entry.visible, 1.0)


def in_words(scene: Scene, item: Item, rows: Mapping, solid: Solid | None, several: bool) -> str:
    entries = [entry for row in rows.values() for entry in row]
    masks = sum(entry.mask is not None for entry in entries)
    where = f" in scene {scene.folder.name}" if several else ""
    words = f"{item.name}: labels{where} in {len(entries)} of {len(scene.frames)} photos, {masks} with masks"
    if solid is not None:
        words += "; " + " x ".join(f"{1000 * side:.1f}" for side in solid.size) + f" mm ({solid.kind})"
    return words
