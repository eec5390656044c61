"""How far the poses that a net finds lie from each other in the frame of a scene in which the object stood still: an
accuracy that needs no truth."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from .registration import angles_deg, mean_pose

AGREES_DEG, AGREES_M = 20.0, 0.1
"""Poses this close to what the other photos say are counted as agreeing."""
MEDIAN_ROUNDS = 20


@dataclass(frozen=True)
class Deviation:
    """One photo's pose against what the other photos of its scene say together."""

    found: np.ndarray | None  # camera_from_keypoints
    """Of poses that look the same the one that is turned least."""
    expected: np.ndarray | None
    """The same by the others."""

    @property
    def compared(self) -> bool:
        return self.found is not None and self.expected is not None

    @property
    def degrees(self) -> float:
        """Not finite where there is no pose, or no other photo has one."""
        return float(angles_deg(self.found[None], self.expected[None])[0, 0]) if self.compared else np.inf

    @property
    def millimetres(self) -> float:
        return 1000 * float(np.linalg.norm(self.found[:3, 3] - self.expected[:3, 3])) if self.compared else np.inf

    @property
    def agrees(self) -> bool:
        return self.degrees < AGREES_DEG and self.millimetres < 1000 * AGREES_M


def deviations(
    scenes: Sequence[Hashable],
    camera_from_scene: Sequence[np.ndarray],
    camera_from_keypoints: Sequence[np.ndarray | None],
    motions: np.ndarray,
) -> list[Deviation]:
    """One a photo. `motions` `[S, 4, 4]`: those of the keypoints' frame under which the object looks the same."""
    found: list[Deviation] = [Deviation(None, None)] * len(scenes)
    for scene in dict.fromkeys(scenes):
        members = [k for k, other in enumerate(scenes) if other == scene]
        solved = [k for k in members if camera_from_keypoints[k] is not None]
        if not solved:
            continue
        poses = np.stack([np.linalg.inv(camera_from_scene[k]) @ camera_from_keypoints[k] for k in solved])
        alike, agreeing = agreement(poses, motions)
        place = {k: number for number, k in enumerate(solved)}
        for k in members:
            others = agreeing.copy()
            if k in place:
                others[place[k]] = False
            expected = camera_from_scene[k] @ middle_pose(alike[others]) if others.any() else None
            seen = None
            if k in place:
                seen = alike[place[k]]
                if expected is not None:
                    seen = nearest(seen[None], np.linalg.inv(camera_from_scene[k]) @ expected, motions)[0]
                seen = camera_from_scene[k] @ seen
            found[k] = Deviation(seen, expected)
    return found


def middle_pose(poses: np.ndarray) -> np.ndarray:
    """Of poses `[P, 4, 4]` the one that most are near to: each counts by one over its distance (Weiszfeld's geometric
    median), so that one of a dozen that is 5 cm off does not move what the others say by half a centimetre."""
    middle = mean_pose(poses)
    for _ in range(MEDIAN_ROUNDS):
        apart = np.linalg.norm(poses[:, :3, 3] - middle[:3, 3], axis=1)
        turned = angles_deg(poses, middle[None])[:, 0]
        place, turn = (1 / np.maximum(off, max(float(np.median(off)), 1e-9)) for off in (apart, turned))
        middle = mean_pose(poses, turn)
        middle[:3, 3] = np.average(poses[:, :3, 3], axis=0, weights=place)
    return middle


def agreement(poses: np.ndarray, motions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All poses as they are nearest to the one that most of them agree with, and which of them do, `[P]`."""
    best = None
    for pose in poses:
        alike = nearest(poses, pose, motions)
        near = angles_deg(alike, pose[None])[:, 0] < AGREES_DEG
        near &= np.linalg.norm(alike[:, :3, 3] - pose[:3, 3], axis=1) < AGREES_M
        if best is None or near.sum() > best[1].sum():
            best = alike, near
    return best


def nearest(poses: np.ndarray, pose: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """Of each pose's equals the one that is turned least from `pose`, `[P, 4, 4]`."""
    alike = poses[:, None] @ motions
    turned = angles_deg(alike.reshape(-1, 4, 4), pose[None]).reshape(alike.shape[:2])
    return alike[np.arange(len(poses)), turned.argmin(1)]


def figures(found: Sequence[Deviation]) -> dict[str, float]:
    """In the median over all photos; one without a pose is a wrong one."""
    result = {"photos": len(found), "agreeing": sum(one.agrees for one in found)}
    degrees, apart = (np.array([getattr(one, name) for one in found]) for name in ("degrees", "millimetres"))
    if len(found) and np.isfinite(np.sort(degrees)[len(found) // 2]):
        result |= {"median_degrees": round(float(np.median(degrees)), 2)}
        result |= {"median_mm": round(float(np.median(apart)), 2)}
    return result


def in_words(result: dict[str, float]) -> str:
    words = f"{result['agreeing']} of {result['photos']} held-out photos agree"
    if "median_degrees" in result:
        words += f"; spread {result['median_degrees']:.1f} degrees, {result['median_mm']:.1f} mm in the median"
    return words
