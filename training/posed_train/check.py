"""Tells, before hours are spent, whether a dataset can teach a keypoint net, and refuses what cannot work."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from . import agreement
from .bop import DatasetError, View
from .registration import Component, find_components, locate, rays_in_component

MIN_BASELINE_DEG = 5.0
"""Pairs of views closer than this say nothing of depth."""
SIZE_RANGE_M = (0.005, 5.0)
COVERAGE_CAP_DEG = 20.0
"""A direction counts as seen when a view lies within this angle of it."""
FEW_VIEWS = 60
FEW_SCENES = 3
SMALL_BOX_PX = 48
LOW_COVERAGE = 0.2


@dataclass
class ComponentReport:
    views: int
    size_m: float
    median_distance_m: float
    widest_baseline_deg: float
    useful_pairs: float
    """Share of pairs of views at least MIN_BASELINE_DEG apart."""
    coverage: float
    """Share of all directions from the object that a view lies near."""


@dataclass
class Report:
    views: int
    components: list[ComponentReport]
    box_px: tuple[float, float, float]
    """Smallest, median and largest longer side of a box."""
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """On masks, and on how well the boxes fit the poses."""
    problems: list[str] = field(default_factory=list)
    """What must be mended."""

    def __str__(self) -> str:
        smallest, median, largest = self.box_px
        lines = [
            f"{self.views} views in {len(self.components)} components; boxes of {smallest:.0f} to {largest:.0f} px, "
            f"median {median:.0f}",
            f"{'component':>9} {'views':>6} {'size, m':>8} {'distance, m':>12} {'baseline, deg':>14} "
            f"{'useful pairs':>13} {'coverage':>9}",
        ]
        for number, c in enumerate(self.components[:10], 1):
            lines.append(
                f"{number:>9} {c.views:>6} {c.size_m:>8.3f} {c.median_distance_m:>12.2f} "
                f"{c.widest_baseline_deg:>14.0f} {c.useful_pairs:>12.0%} {c.coverage:>9.0%}"
            )
        if len(self.components) > 10:
            lines.append(f"          ... and {len(self.components) - 10} more")
        lines += self.notes + [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)


def check(
    views: list[View], source: str, size_mm: Sequence[float] | None = None, up: np.ndarray | None = None
) -> Report:
    """Raises DatasetError for what cannot work at all. `size_mm` is the object's by a ruler, `up` the direction away
    from the board through the origin of each scene that it stands on."""
    check_cameras(views)
    components = find_components(views, source)
    if len(components[0].views) < 2:
        raise DatasetError(
            "every image is alone in its component: learning needs pairs of images with known relative camera poses. "
            "Take several images of one still scene"
        )
    angles = [baseline(component, views) for component in components]
    if angles[0] < MIN_BASELINE_DEG:
        raise DatasetError(
            f"all views of the largest component lie within {angles[0]:.1f} degrees of each other: depth cannot be "
            f"learned. Move the camera at least {MIN_BASELINE_DEG:.0f} degrees around the object"
        )
    wide = [component for component, angle in zip(components, angles) if angle >= MIN_BASELINE_DEG]
    notes, problems = agree(views, wide, source, size_mm, up)
    if problems and not can_be_described(wide, views):
        raise DatasetError("\n  ".join(["the dataset cannot be used:", *problems]))
    reports = [describe(component, views) for component in wide]
    sizes = np.array([report.size_m for report in reports])
    if sizes.max() > 3 * sizes.min():
        raise DatasetError(
            f"the object measures {sizes.min():.3g} m in one component and {sizes.max():.3g} m in another: camera "
            "poses in mixed units, or a scene whose scale is wrong. BOP wants millimetres everywhere"
        )
    sides = np.array([max(view.box[2:]) for view in views])
    report = Report(len(views), reports, (sides.min(), float(np.median(sides)), sides.max()))
    report.notes, report.problems = notes, problems
    warn(report, len(components) - len(reports))
    if source == "camera" and len(wide) <= FEW_SCENES and not any(view.mask_path for view in views):
        report.warnings.append(
            "no masks: in photos of so few still scenes a net learns what is around the object instead of it. "
            "`posed-train label` finds them"
        )
    return report


def agree(
    views: list[View], components: list[Component], source: str, size_mm: Sequence[float] | None, up: np.ndarray | None
) -> tuple[list[str], list[str]]:
    """Notes and problems: whether poses, boxes, masks and the size agree."""
    masks, mask_problems = agreement.masks_found(views)
    notes, problems, sized = [masks], [], False
    for component in components:
        problems += agreement.rotations(views, component)
        if source != "camera":  # the order of photos, and still scenes, are camera poses' alone
            continue
        found, seen, shown = agreement.boxes_meet(views, component)
        problems += agreement.whose_order(found, bool(mask_problems))
        if not found and not mask_problems:
            problems += agreement.stands_still(views, component)
        if seen is not None and not sized:  # the largest component tells enough
            sized = True
            notes.append(agreement.describe_meeting(seen))
            if size_mm and not found and can_be_described([component], views):
                words, problem = agreement.size_agrees([views[k] for k in shown], seen, size_mm, up)
                notes.append(words)
                problems += [problem] if problem else []
    return notes, problems + mask_problems


def can_be_described(components: list[Component], views: list[View]) -> bool:
    try:
        return bool([describe(component, views) for component in components])
    except DatasetError:
        return False


def check_cameras(views: list[View]) -> None:
    """That each image's camera parameters fit it, and boxes lie inside it."""
    for view, (width, height) in zip(views, agreement.image_sizes(views)):
        fx, fy, cx, cy = (view.camera_matrix[i, j] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
        if not (0.2 * width < cx < 0.8 * width and 0.2 * height < cy < 0.8 * height and min(fx, fy) > 0.2 * width):
            raise DatasetError(
                f"{view.image_path}: cam_K (fx {fx:.0f}, fy {fy:.0f}, cx {cx:.0f}, cy {cy:.0f}) does not fit an image "
                f"of {width:.0f}x{height:.0f} px; was the image resized after the camera was calibrated?"
            )
        x, y, w, h = view.box
        if x < 0 or y < 0 or x + w > width or y + h > height:
            raise DatasetError(
                f"{view.image_path}: bbox_visib {list(view.box)} reaches outside the image of "
                f"{width:.0f}x{height:.0f} px"
            )


def baseline(component: Component, views: list[View]) -> float:
    """The widest angle between its rays, degrees. Not measured from the point that they meet in, which is noise where
    all are nearly parallel."""
    rays = rays_in_component([views[index] for index in component.views], component.camera_from_component)
    return float(np.degrees(np.arccos(np.clip(rays @ rays.T, -1, 1))).max())


def describe(component: Component, views: list[View]) -> ComponentReport:
    chosen = [views[index] for index in component.views]
    poses = component.camera_from_component
    centre, extent = locate(chosen, poses)
    size = float(np.median(extent))
    low, high = SIZE_RANGE_M
    if not low < size < high:
        raise DatasetError(
            f"{chosen[0].image_path.parent.parent}: the object would measure {size:.3g} m; translations "
            "are read as millimetres, so a dataset in metres comes out a thousand times too small, and one in "
            "micrometres too large"
        )
    cameras = -np.einsum("vji,vj->vi", poses[:, :3, :3], poses[:, :3, 3]) - centre
    directions = cameras / np.linalg.norm(cameras, axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))[np.triu_indices(len(chosen), 1)]
    seen = (sphere(500) @ directions.T).max(1) > np.cos(np.radians(COVERAGE_CAP_DEG))
    return ComponentReport(
        views=len(chosen),
        size_m=size,
        median_distance_m=float(np.median(np.linalg.norm(cameras, axis=1))),
        widest_baseline_deg=float(angles.max()),
        useful_pairs=float(np.mean(angles > MIN_BASELINE_DEG)),
        coverage=float(np.mean(seen)),
    )


def sphere(count: int) -> np.ndarray:
    """Unit vectors spread evenly (Fibonacci's spiral)."""
    k = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    return np.stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=1)


def warn(report: Report, narrow: int) -> None:
    first = report.components[0]
    if narrow:
        report.warnings.append(
            f"{narrow} components have one image, or images from one direction; those images teach nothing"
        )
    if report.views < FEW_VIEWS:
        report.warnings.append(f"{report.views} views are few; {FEW_VIEWS} to 200 from all sides learn well")
    if first.coverage < LOW_COVERAGE:
        report.warnings.append(
            f"the largest component sees the object from {first.coverage:.0%} of all directions; poses seen from "
            "elsewhere will be poor"
        )
    if report.box_px[1] < SMALL_BOX_PX:
        report.warnings.append(f"the object is {report.box_px[1]:.0f} px large in the median; go nearer")
