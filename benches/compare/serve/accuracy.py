"""How right the answers are."""

import json
from dataclasses import dataclass, field

import numpy as np
from servers import ROOT

INFO = json.loads((ROOT / "training/demo/models/models_info.json").read_text())
IDS = {about["name"]: int(number) for number, about in INFO.items()}
WHOLE = 0.7
"""Least visible fraction of a view that counts."""


@dataclass
class Truth:
    """Objects of an image: id, pose [4, 4] in metres, visible fraction."""

    image: bytes
    camera: str
    objects: list


@dataclass
class Score:
    views: int = 0
    found: int = 0
    degrees: list = field(default_factory=list)  # of the views; 180 and infinity where there is no answer
    millimetres: list = field(default_factory=list)
    corners: list = field(default_factory=list)  # mean error of the bounding box's corners, of the diameter
    wrong: list = field(default_factory=list)  # of all answers: whether it is off by more than a tenth, or of nothing


def pose_of(rotation_xyzw, translation_m):
    x, y, z, w = rotation_xyzw
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = translation_m
    return matrix


def samples():
    for name, objects in json.loads((ROOT / "samples/poses.json").read_text()).items():
        poses = [(o["obj_id"], pose_of(o["rotation_xyzw"], o["translation_m"]), 1.0) for o in objects]
        yield Truth((ROOT / "samples" / name).read_bytes(), "demo", poses)


def split(folder, cameras):
    """The images of a split in the BOP format. Writes a file for each of their cameras."""
    names = {}
    for scene in sorted(path.parent for path in folder.glob("*/scene_gt.json")):
        camera, truth, info = (
            json.loads((scene / f"scene_{name}.json").read_text()) for name in ("camera", "gt", "gt_info")
        )
        for image in sorted((scene / "rgb").iterdir()):
            key = str(int(image.stem))
            matrix = tuple(camera[key]["cam_K"])
            if matrix not in names:
                names[matrix] = f"split-{len(names)}"
                fx, fy, cx, cy = (matrix[at] for at in (0, 4, 2, 5))
                content = {"model": "pinhole", "width": 0, "height": 0, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
                content |= dict(zip(("width", "height"), size_of(image), strict=True))
                (cameras / f"{names[matrix]}.camera.json").write_text(json.dumps(content))
            poses = []
            for o, about in zip(truth[key], info[key], strict=True):
                pose = np.eye(4)
                pose[:3, :3] = np.reshape(o["cam_R_m2c"], (3, 3))
                pose[:3, 3] = np.array(o["cam_t_m2c"]) / 1000
                poses.append((o["obj_id"], pose, about["visib_fract"]))
            yield Truth(image.read_bytes(), names[matrix], poses)


def size_of(path):
    from PIL import Image

    with Image.open(path) as image:
        return image.size


def score(truths, answers):
    """`answers` are lists of what `/v1/poses` says of each object."""
    total = Score()
    for truth, poses in zip(truths, answers, strict=True):
        left = [entry for entry in truth.objects if entry[2] > 0.1]
        whole = [entry for entry in left if entry[2] >= WHOLE]
        total.views += len(whole)
        matched = 0
        for pose in poses:
            found = pose["camera_from_object"]
            estimate = found and pose_of(found["rotation_xyzw"], found["translation_m"])
            same = [at for at, entry in enumerate(left) if entry[0] == IDS[pose["object"]]]
            if estimate is None:
                continue
            if not same:
                total.wrong.append(True)
                continue
            at = min(same, key=lambda at: np.linalg.norm(left[at][1][:3, 3] - estimate[:3, 3]))
            number, true, visible = left.pop(at)
            degrees, millimetres, corners = errors(INFO[str(number)], estimate, true)
            total.wrong.append(corners > 0.1)
            if visible >= WHOLE:
                matched += 1
                total.degrees.append(degrees)
                total.millimetres.append(millimetres)
                total.corners.append(corners)
        total.found += matched
        for _ in range(len(whole) - matched):
            total.degrees.append(180.0)
            total.millimetres.append(np.inf)
            total.corners.append(np.inf)
    return total


def errors(info, estimate, true):
    """Rotation (degrees), translation (mm), and the corners' error: of the symmetric pose that is nearest."""
    alike = [np.eye(4), *(np.reshape(s, (4, 4)).astype(float) for s in info.get("symmetries_discrete", []))]
    least, size = (np.array([info[f"{kind}_{axis}"] for axis in "xyz"]) / 1000 for kind in ("min", "size"))
    corners = least + size * np.array(list(np.ndindex(2, 2, 2)))
    best = None
    for motion in alike:
        motion = motion.copy()
        motion[:3, 3] /= 1000
        pose = true @ motion
        chord = np.linalg.norm(estimate[:3, :3] - pose[:3, :3]) / np.sqrt(8)
        degrees = 2 * np.degrees(np.arcsin(min(chord, 1.0)))
        apart = np.linalg.norm(moved(estimate, corners) - moved(pose, corners), axis=1).mean()
        entry = degrees, 1000 * np.linalg.norm(estimate[:3, 3] - pose[:3, 3]), apart / (info["diameter"] / 1000)
        best = min(best or entry, entry)
    return best


def moved(pose, points):
    return points @ pose[:3, :3].T + pose[:3, 3]
