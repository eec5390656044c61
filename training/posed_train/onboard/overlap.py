"""Pairs that show one still scene become one component: what their photos share tells how their cameras stand.

Points that both photos of a pair show have a place in space, in metres, by the pair's relative pose. Where another
pair sees them again, they tell its pose (PnP). So components grow, from the pair that shares most with others, by the
one on whose pose most of those that are placed agree; in the end each pose is fitted to all that its neighbours know.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from ..rays import origin
from ..registration import agree, mean_pose, project
from .photos import listed
from .scene import Shot

FEATURES = 2000
RATIO = 0.8
"""Of the distances of the best and the second best likeness (Lowe, IJCV 2004)."""
LEAST_PARALLAX_DEG = 0.5
NEAR_PX = 2.0
LEAST_SHARED = 20
"""Points that must agree on a pose, in both photos together."""
LEAST_EACH = 6
"""In each of them, of all that agree on a pair's pose: so its own pose is borne out, too."""
ENOUGH_ALIKE, LEAST_FITTING = 30, 0.3
"""Where so many points of a pair's photos agree on some pose, this share of them fits the pair's if that is true."""
LEAST_SPREAD = 0.1
"""Of the image's width, standard deviation: points in one corner tell no pose."""
CANDIDATES = 12
"""Other pairs that each is compared with, by a quick look at its strongest features..."""
QUICK = 200
NEIGHBOURS_IN_ORDER = 3
"""... and those before and after it."""
NEAR_DEG, NEAR_SHARE = 1.5, 0.015
"""Within which poses agree; the second of the points' distance."""
LEAST_VOTES = 2
"""For a pose: where things look alike, as the tags of a board do, a sighting may be wrong."""
ROUNDS = 3
RANSAC_ROUNDS = 500
MOST_POINTS = 800
"""That a pose is fitted to."""


@dataclass(frozen=True)
class Seen:
    """A photo's features, pixels without distortion."""

    matrix: np.ndarray
    width: int
    pixels: np.ndarray  # [F, 2]
    descriptors: np.ndarray  # [F, 128], strongest first


@dataclass(frozen=True)
class Landmarks:
    """What both photos of a pair show, in the first camera's frame."""

    points: np.ndarray  # [P, 3]
    descriptors: np.ndarray  # [P, 128]


@dataclass(frozen=True)
class Pair:
    seen: tuple[Seen, Seen]
    camera_from_first: tuple[np.ndarray, np.ndarray]
    """The first is the identity."""
    landmarks: Landmarks
    fits: bool
    """Whether what its photos share fits its pose, as far as that can be told."""


@dataclass(frozen=True)
class Sighting:
    """Points of one pair, where the photos of another show them."""

    points: np.ndarray  # [P, 3] in the first pair's frame
    pixels: np.ndarray  # [P, 2]
    camera: np.ndarray  # [P] 0 or 1
    pose: np.ndarray | None = None
    """That they agree on, from that frame to the other pair's."""


@dataclass(frozen=True)
class Joined:
    """What became of pairs."""

    components: list[list[Shot]]
    """The largest first."""
    misfits: list[str]
    """Names of left photos of pairs whose pose is not that of their photos."""


def join_pairs(scenes: Sequence[list[Shot]]) -> Joined:
    pairs = [read_pair(shots) for shots in tqdm(scenes, "pairs: features", mininterval=5)]
    sightings = find_sightings(pairs)
    components = []
    waiting = set(range(len(pairs)))
    while waiting:
        placed = grow(pairs, sightings, waiting)
        waiting -= placed.keys()
        components.append(
            [
                replace(shot, camera_from_world=camera_from_first @ np.linalg.inv(placed[k]))
                for k in sorted(placed)
                for shot, camera_from_first in zip(scenes[k], pairs[k].camera_from_first)
            ]
        )
    misfits = [shots[0].photo.name for shots, pair in zip(scenes, pairs) if not pair.fits]
    return Joined(sorted(components, key=lambda shots: -len(shots)), misfits)


def in_words(joined: Joined) -> list[str]:
    """What became of the pairs, and what to do about it."""
    sizes = [len(shots) // 2 for shots in joined.components]
    lines = []
    if joined.misfits:
        lines.append(
            f"{len(joined.misfits)} pairs are not as their photos show them: {listed(joined.misfits)}. right_from_left "
            "is the left camera's pose in the right one's frame, in OpenCV's axes; are the cameras those of the photos?"
        )
    if max(sizes) == 1:
        return [
            f"{len(sizes)} pairs of which no two share enough of a scene: each is a component, and a net cannot learn "
            "from one pair. Take pairs closer to each other, with more than the object in sight, or give all poses",
            *lines,
        ]
    lines.append(
        f"{sum(sizes)} pairs joined by what their photos share: {len(sizes)} component{'s' * (len(sizes) > 1)}. "
        "Between photos of one scene the object must not have been moved (`check` tells); --apart joins none"
    )
    if len(sizes) > 1:
        lone = listed(shots[0].photo.name for shots in joined.components[1:])
        lines.append(
            f"the largest has {sizes[0]} pairs, and training begins with it; the net must place the others itself. "
            f"Take pairs between it and those of {lone}"
        )
    return lines


def read_pair(shots: Sequence[Shot]) -> Pair:
    seen = tuple(look(shot) for shot in shots)
    world_from_first = np.linalg.inv(shots[0].camera_from_world)
    poses = tuple(shot.camera_from_world @ world_from_first for shot in shots)
    landmarks, fits = triangulate(seen, poses)
    return Pair(seen, poses, landmarks, fits)


def look(shot: Shot) -> Seen:
    image = shot.camera.undistort(shot.photo.read_grey())
    found, descriptors = cv2.SIFT_create(FEATURES).detectAndCompute(image, None)
    order = np.argsort([-one.response for one in found], kind="stable")[:FEATURES]
    pixels = np.array([found[k].pt for k in order]).reshape(-1, 2)
    values = np.zeros((0, 128)) if descriptors is None else descriptors[order]
    # Hellinger's distance tells features better apart (Arandjelovic and Zisserman, CVPR 2012).
    values = np.sqrt(values / np.maximum(values.sum(1, keepdims=True), 1e-6)).astype(np.float32)
    return Seen(shot.camera.matrix, shot.camera.width, pixels, values)


def alike(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Indices `[M, 2]` of descriptors that are nearest to each other, and much nearer than to any other."""
    if min(len(first), len(second)) < 2:
        return np.zeros((0, 2), int)
    likeness = first @ second.T
    best = likeness.argmax(1)
    rows = np.arange(len(first))
    nearest = likeness[rows, best]
    likeness[rows, best] = -1
    # Of unit vectors the squared distance is 2 - 2 likeness.
    clear = 1 - nearest < RATIO**2 * (1 - likeness.max(1))
    likeness[rows, best] = nearest
    mutual = likeness.argmax(0)[best] == rows
    kept = np.flatnonzero(clear & mutual)
    return np.column_stack([kept, best[kept]])


def triangulate(seen: tuple[Seen, Seen], poses: tuple[np.ndarray, np.ndarray]) -> tuple[Landmarks, bool]:
    """What a pair knows the place of; and whether what looks alike in its photos fits its pose."""
    first, second = seen
    found = alike(first.descriptors, second.descriptors)
    if not len(found):
        return Landmarks(np.zeros((0, 3)), np.zeros((0, 128), np.float32)), True
    pixels = first.pixels[found[:, 0]], second.pixels[found[:, 1]]
    projections = [one.matrix @ pose[:3] for one, pose in zip(seen, poses)]
    points = cv2.triangulatePoints(*projections, pixels[0].T, pixels[1].T)
    # A point at infinity is a far one.
    points = (points[:3] / np.where(np.abs(points[3]) < 1e-9, 1e-9, points[3])).T
    good = np.ones(len(points), bool)
    for one, pose, at in zip(seen, poses, pixels):
        good &= points @ pose[2, :3] + pose[2, 3] > 0
        good &= np.linalg.norm(project(one.matrix, pose, points) - at, axis=1) < NEAR_PX
    fits = good.sum() >= LEAST_FITTING * epipolar(seen, pixels)
    rays = [points - origin(pose) for pose in poses]
    rays = [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays]
    good &= (rays[0] * rays[1]).sum(1) < np.cos(np.radians(LEAST_PARALLAX_DEG))
    return Landmarks(points[good], first.descriptors[found[good, 0]]), fits


def epipolar(seen: tuple[Seen, Seen], pixels: tuple[np.ndarray, np.ndarray]) -> int:
    """How many points agree on some pose of the two cameras, if that is most and enough to say so; else 0."""
    if len(pixels[0]) < ENOUGH_ALIKE:
        return 0
    normalised = [
        cv2.undistortPoints(np.ascontiguousarray(at[:, None]), one.matrix, None)[:, 0] for one, at in zip(seen, pixels)
    ]
    threshold = NEAR_PX / np.mean([one.matrix[0, 0] for one in seen])
    _, agreeing = cv2.findEssentialMat(*normalised, np.eye(3), cv2.USAC_DEFAULT, 0.999, threshold)
    count = 0 if agreeing is None else int(np.count_nonzero(agreeing))
    return count if count >= max(ENOUGH_ALIKE, len(pixels[0]) / 2) else 0


def find_sightings(pairs: Sequence[Pair]) -> dict[tuple[int, int], Sighting]:
    """What of each pair's landmarks another pair's photos show, by the two pairs, if it tells a pose."""
    sightings = {}
    for a, b in tqdm(sorted(candidates(pairs)), "pairs: what they share", mininterval=5):
        if not (pairs[a].fits and pairs[b].fits):
            continue
        for one, other in ((a, b), (b, a)):
            sighting = agreeing(pairs[other], sight(pairs[one].landmarks, pairs[other]))
            if sighting is not None:
                sightings[one, other] = sighting
    return sightings


def candidates(pairs: Sequence[Pair]) -> set[tuple[int, int]]:
    strongest = [pair.seen[0].descriptors[:QUICK] for pair in pairs]
    shared = np.zeros((len(pairs), len(pairs)))
    for a, b in combinations(range(len(pairs)), 2):
        shared[a, b] = shared[b, a] = len(alike(strongest[a], strongest[b]))
    chosen = {(a, b) for a in range(len(pairs)) for b in np.argsort(-shared[a])[:CANDIDATES] if shared[a, b]}
    chosen |= {(a, a + k) for k in range(1, NEIGHBOURS_IN_ORDER + 1) for a in range(len(pairs) - k)}
    return {(min(a, b), max(a, b)) for a, b in chosen}


def sight(landmarks: Landmarks, pair: Pair) -> Sighting:
    found = [alike(landmarks.descriptors, one.descriptors) for one in pair.seen]
    return Sighting(
        points=np.concatenate([landmarks.points[each[:, 0]] for each in found]),
        pixels=np.concatenate([one.pixels[each[:, 1]] for one, each in zip(pair.seen, found)]),
        camera=np.repeat([0, 1], [len(each) for each in found]),
    )


def agreeing(pair: Pair, sighting: Sighting) -> Sighting | None:
    """What agrees with one pose of the pair; nothing if too little does."""
    best = None
    for camera in (0, 1):
        of_camera = sighting.camera == camera
        if of_camera.sum() < LEAST_SHARED // 2:
            continue
        found, turn, shift, inliers = cv2.solvePnPRansac(
            sighting.points[of_camera], sighting.pixels[of_camera], pair.seen[camera].matrix, None,
            iterationsCount=RANSAC_ROUNDS, reprojectionError=NEAR_PX, confidence=0.9999, flags=cv2.SOLVEPNP_AP3P,
        )  # fmt: skip
        if not found or inliers is None:
            continue
        first_from_other = np.linalg.inv(pair.camera_from_first[camera]) @ pose_of(turn.ravel(), shift.ravel())
        near = is_near(pair, sighting, first_from_other)
        if best is None or near.sum() > best[0].sum():
            best = near, first_from_other
    if best is None or best[0].sum() < LEAST_SHARED:
        return None
    near, pose = best
    if sighting.pixels[near].std(0).max() < LEAST_SPREAD * pair.seen[0].width:
        return None
    return Sighting(sighting.points[near], sighting.pixels[near], sighting.camera[near], pose)


def is_near(pair: Pair, sighting: Sighting, first_from_points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(residuals(pair, sighting, first_from_points), axis=1) < NEAR_PX


def residuals(pair: Pair, sighting: Sighting, first_from_points: np.ndarray) -> np.ndarray:
    """`[P, 2]` pixels."""
    out = np.zeros_like(sighting.pixels)
    for camera, (seen, pose) in enumerate(zip(pair.seen, pair.camera_from_first)):
        of_camera = sighting.camera == camera
        projected = project(seen.matrix, pose @ first_from_points, sighting.points[of_camera])
        out[of_camera] = projected - sighting.pixels[of_camera]
    return out


def pose_of(rotation_vector: np.ndarray, translation: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(rotation_vector).as_matrix(), translation
    return pose


def grow(pairs: Sequence[Pair], sightings: dict[tuple[int, int], Sighting], waiting: set[int]) -> dict[int, np.ndarray]:
    """`world_from_first` of the pairs of one component, whose world is the frame of one of them."""
    edges = {(a, b): one for (a, b), one in sightings.items() if a in waiting and b in waiting}
    weight = {k: sum(len(one.points) for edge, one in edges.items() if k in edge) for k in waiting}
    near_m = NEAR_SHARE * np.median([np.median(np.linalg.norm(one.points, axis=1)) for one in edges.values()] or [1.0])
    placed = {max(sorted(waiting), key=weight.__getitem__): np.eye(4)}
    while True:
        told = {k: vote(k, edges, placed, near_m) for k in sorted(waiting - placed.keys())}
        agreed = {k: one for k, one in told.items() if one is not None}
        if not agreed:
            break
        chosen = max(agreed, key=lambda k: agreed[k][1])
        placed[chosen] = agreed[chosen][0]
        placed[chosen] = fit(pairs[chosen], known_to(chosen, edges, placed, near_m), placed[chosen])
    for _ in range(ROUNDS):
        for k in list(placed)[1:]:
            placed[k] = fit(pairs[k], known_to(k, edges, placed, near_m), placed[k])
    return placed


def vote(
    index: int, edges: dict[tuple[int, int], Sighting], placed: dict[int, np.ndarray], near_m: float
) -> tuple[np.ndarray, int] | None:
    """`world_from_first` of a pair, by the placed ones that see its points and those whose points it sees; and how many
    of them agree. Nothing where too few do, or where they bear out one of its photos alone."""
    seeing = [(placed[b] @ one.pose, one) for (a, b), one in edges.items() if a == index and b in placed]
    seen = [(placed[a] @ np.linalg.inv(one.pose), one) for (a, b), one in edges.items() if b == index and a in placed]
    if len(seeing) + len(seen) < LEAST_VOTES:
        return None
    poses = np.stack([pose for pose, _ in seeing + seen])
    # Its points are known by both of its photos.
    shown = [(len(one.points),) * 2 for _, one in seeing]
    shown += [tuple((one.camera == camera).sum() for camera in (0, 1)) for _, one in seen]
    agreeing = agree(poses, poses, NEAR_DEG, near_m)
    counts = np.where((agreeing @ np.array(shown)).min(1) >= LEAST_EACH, agreeing.sum(1), 0)
    best = int(counts.argmax())
    return (mean_pose(poses[agreeing[best]]), int(counts[best])) if counts[best] >= LEAST_VOTES else None


def known_to(
    index: int, edges: dict[tuple[int, int], Sighting], placed: dict[int, np.ndarray], near_m: float
) -> Sighting:
    """What a pair sees of the others' points, in the world's frame: of those that agree with where it stands."""
    of_it = [
        (placed[a], one)
        for (a, b), one in edges.items()
        if b == index
        and a in placed
        and agree((placed[a] @ np.linalg.inv(one.pose))[None], placed[b][None], NEAR_DEG, near_m)[0, 0]
    ]
    return Sighting(
        points=np.concatenate([np.zeros((0, 3)), *(one.points @ pose[:3, :3].T + pose[:3, 3] for pose, one in of_it)]),
        pixels=np.concatenate([np.zeros((0, 2)), *(one.pixels for _, one in of_it)]),
        camera=np.concatenate([np.zeros(0, int), *(one.camera for _, one in of_it)]),
    )


def fit(pair: Pair, known: Sighting, world_from_first: np.ndarray) -> np.ndarray:
    """A better `world_from_first` of a pair, by all that it sees."""
    if len(known.points) < LEAST_SHARED:
        return world_from_first
    start = np.linalg.inv(world_from_first)
    some = slice(None, None, max(1, len(known.points) // MOST_POINTS))
    known = Sighting(known.points[some], known.pixels[some], known.camera[some])

    def errors(step: np.ndarray) -> np.ndarray:
        return residuals(pair, known, pose_of(step[:3], step[3:]) @ start).ravel()

    step = least_squares(errors, np.zeros(6), loss="soft_l1", f_scale=0.5, x_scale="jac").x
    return np.linalg.inv(pose_of(step[:3], step[3:]) @ start)
