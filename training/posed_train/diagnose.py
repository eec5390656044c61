"""Names what is wrong with a dataset whose boxes do not meet in one point: each mistake that is known is undone, to see
whether they meet then."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .residual import ONE_PHOTO, USUAL, Sights, middle, typical

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
SCALES = np.geomspace(0.3, 3.4, 41)
FOCAL_SCALES = np.geomspace(0.6, 1.6, 21)
LEAST_FOR_FOCAL = 15
NAMED = 12
LEAST_HALF = 5
MOST_WRONG = 0.35
"""Share of photos, beyond which it is not single photos that are wrong."""
CURES = 0.5
"""What undoes the mistake makes the residual smaller than this share of what it was."""


@dataclass(frozen=True)
class Finding:
    """What is wrong, and the residual when it is put right."""

    words: str
    residual: float


def diagnose(seen: Sights, names: Sequence[str]) -> list[str]:
    """What is wrong with the photos of one component, in the order in which they were taken; nothing if all is well."""
    found = middle(seen)[1]
    usual, wrong = float(np.median(found)), found > ONE_PHOTO
    if usual <= USUAL and not wrong.any():
        return wrong_focal_length(seen, found)
    if (moved := moved_midway(seen, names)) is not None and moved.residual < USUAL:
        return [moved.words]
    if usual <= USUAL or (wrong.mean() <= MOST_WRONG and np.median(found[~wrong]) <= USUAL):
        return [single_photos(names, found, wrong)]
    best = min((finding for test in TESTS for finding in test(seen, usual)), key=lambda one: one.residual)
    if best.residual < CURES * usual and best.residual < max(USUAL, 0.25 * usual):
        return [
            f"{best.words} (the boxes' middles lie {usual:.2f} of a box's side off; put right, {best.residual:.2f})"
        ]
    return [
        f"the boxes do not meet in one point: their middles lie {usual:.2f} of a box's side off in the median, where "
        f"right data have 0.03. Camera parameters, poses or boxes are wrong; worst: {worst(names, found)}"
    ]


def wrong_focal_length(seen: Sights, found: np.ndarray) -> list[str]:
    """Photos that all look straight at the object from one distance hide it: the boxes meet nearly as well."""
    if len(seen) < LEAST_FOR_FOCAL:
        return []
    now = float(np.mean(np.square(found)))
    scores = [(float(np.mean(np.square(middle(scaled(seen, scale, False))[1]))), scale) for scale in FOCAL_SCALES]
    best, scale = min(scores)
    if best > CURES * now or 0.9 < scale < 1.1:
        return []
    return [
        f"fx and fy in cam_K are about {1 / scale:.1f} times what fits the photos best, though the boxes nearly meet: "
        "calibrate the camera again"
    ]


def worst(names: Sequence[str], found: np.ndarray) -> str:
    order = np.argsort(-found)[:NAMED]
    return ", ".join(f"{names[k]} ({found[k]:.1f})" for k in order)


def single_photos(names: Sequence[str], found: np.ndarray, wrong: np.ndarray) -> str:
    count = int(wrong.sum())
    shown = (
        worst(names, np.where(wrong, found, -1)[: len(names)])
        if count >= NAMED
        else ", ".join(f"{names[k]} ({found[k]:.1f})" for k in np.argsort(-found)[:count])
    )
    more = f" and {count - NAMED} more" if count > NAMED else ""
    return (
        f"{count} of {len(names)} photos have a wrong pose or box (off by this many box sides): {shown}{more}. Leave "
        "them out, or pose or draw them again"
    )


def moved_midway(seen: Sights, names: Sequence[str]) -> Finding | None:
    """Each part is well for itself, together they are not."""
    count, best = len(seen), None
    if count < 2 * LEAST_HALF:
        return None
    whole = typical(seen)
    candidates = sorted({int(k) for k in np.linspace(LEAST_HALF, count - LEAST_HALF, min(24, count))})
    for fine in (False, True):
        if fine:
            candidates = [
                k
                for k in range(best[1] - count // 20 - 1, best[1] + count // 20 + 2)
                if LEAST_HALF <= k <= count - LEAST_HALF
            ]
        for k in candidates:
            parts = [middle(seen[:k]), middle(seen[k:])]
            both = np.concatenate([found for _, found in parts])
            score = float(np.minimum(both, ONE_PHOTO).mean())
            if best is None or score < best[0]:
                best = score, k, both, np.linalg.norm(parts[0][0] - parts[1][0])
    _, k, both, distance = best
    after = float(np.median(both))
    # Wrong photos scattered over the sequence stay wrong in both parts.
    if (both > ONE_PHOTO).mean() > 0.05 or after > USUAL or middle(seen)[1].mean() < 2 * both.mean() or whole < after:
        return None
    return Finding(
        f"the object, or what its place is known by, moved {1000 * distance:.0f} mm after photo {names[k - 1]} (before "
        f"{names[k]}): two components. Put the photos after it into a scene of their own (`posed-train new --to`, "
        "`posed-train add --from`)",
        after,
    )


def camera_parameters(seen: Sights, usual: float) -> list[Finding]:
    findings = []
    for whole_matrix in (True, False):
        scored = [(typical(scaled(seen, scale, whole_matrix)), scale) for scale in SCALES]
        _, scale = min(scored)
        finer = scale * np.geomspace(0.97, 1.03, 7)
        scored += [(typical(scaled(seen, scale, whole_matrix)), scale) for scale in finer]
        residual, scale = min(scored)
        if 0.93 < scale < 1.07:
            continue
        if whole_matrix:
            words = (
                f"cam_K is of images {1 / scale:.2f} times as large as these: multiply fx, fy, cx and cy by {scale:.2f}"
                ", or use the images that the camera was calibrated with"
            )
        else:
            words = f"fx and fy in cam_K are {1 / scale:.2f} times what fits the photos: calibrate the camera again"
        findings.append(Finding(words, residual))
    findings.append(resolution(seen))
    return findings


def scaled(seen: Sights, scale: float, whole_matrix: bool) -> Sights:
    matrix = seen.camera_matrix.copy()
    matrix[:, :2, : 3 if whole_matrix else 2] *= scale
    return replace(seen, camera_matrix=matrix)


def resolution(seen: Sights) -> Finding:
    """The principal point in the middle of the image, and a focal length that fits."""
    matrix = seen.camera_matrix.copy()
    matrix[:, :2, 2] = (seen.size - 1) / 2
    scores = []
    for scale in SCALES:
        tried = matrix.copy()
        tried[:, [0, 1], [0, 1]] *= scale
        scores.append((typical(replace(seen, camera_matrix=tried)), scale))
    residual, scale = min(scores)
    f = scale * float(np.median(seen.camera_matrix[:, 0, 0]))
    cx, cy = np.median(seen.camera_matrix[:, :2, 2], axis=0)
    width, height = seen.size[0]
    words = (
        f"cam_K is of another resolution: cx {cx:.0f}, cy {cy:.0f} are not the middle of {width:.0f}x{height:.0f} px, "
        f"and fx {f:.0f} fits better than {np.median(seen.camera_matrix[:, 0, 0]):.0f}"
    )
    return Finding(words, residual * 1.05)  # a guess: what explains the data as well without it comes first


def conventions(seen: Sights, usual: float) -> list[Finding]:
    poses = seen.camera_from_component
    inverse = np.linalg.inv(poses)
    tried: list[tuple[str, np.ndarray]] = [
        ("poses are the wrong way round: cam_R_w2c and cam_t_w2c must map the scene to the camera, not back", inverse),
        (
            "poses have OpenGL's camera axes (y up, z backwards): turn them to OpenCV's by diag(1, -1, -1)",
            OPENGL @ poses,
        ),
        (
            "poses are the wrong way round and have OpenGL's camera axes (y up, z backwards): invert them, then turn "
            "them by diag(1, -1, -1)",
            OPENGL @ inverse,
        ),
        (
            "poses are the wrong way round and have OpenGL's camera axes: turn them by diag(1, -1, -1), then invert "
            "them",
            np.linalg.inv(OPENGL @ poses),
        ),
    ]
    return [Finding(words, typical(seen.with_poses(changed))) for words, changed in tried]


def boxes(seen: Sights, usual: float) -> list[Finding]:
    shifts = (
        (0.5, "bbox_visib starts at the box's middle: its x and y must be the left and upper edge"),
        (-0.5, "bbox_visib is half a box too far to the left and up: its x and y must be the left and upper edge"),
    )
    findings = []
    for share, words in shifts:
        moved = seen.boxes.copy()
        moved[:, :2] -= share * moved[:, 2:]
        findings.append(Finding(words, typical(replace(seen, boxes=moved))))
    return findings


def order(seen: Sights, usual: float) -> list[Finding]:
    """Poses against boxes, one photo off."""
    findings = []
    for step, words in ((1, "next"), (-1, "one before")):
        poses = np.roll(seen.camera_from_component, step, axis=0)[1:-1]
        changed = seen[slice(1, -1)].with_poses(poses)
        findings.append(
            Finding(
                f"{OFF_BY_ONE}: each photo has the pose of the {words}, or its box is of the photo on the other side",
                typical(changed),
            )
        )
    return findings


OFF_BY_ONE = "poses and boxes are one photo off"
TESTS: tuple[Callable[[Sights, float], list[Finding]], ...] = (camera_parameters, conventions, boxes, order)
