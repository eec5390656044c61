"""Writes posed photos as other tools do, to see whether they come back the same. `photos` has folder, names,
camera_from_world (metres), matrix, width and height."""

import json
import shutil
import struct

import numpy as np
from scipy.spatial.transform import Rotation

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def pinhole(photos):
    return (float(photos.matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))


def wxyz(pose):
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return [w, x, y, z]


def write_transforms(photos, path, unit=1.0, **more):
    fx, fy, cx, cy = pinhole(photos)
    frames = []
    for name, pose in zip(photos.names, photos.camera_from_world):
        world_from_opengl = np.linalg.inv(OPENGL @ pose)
        world_from_opengl[:3, 3] /= unit
        frames.append({"file_path": f"images/{name}", "transform_matrix": world_from_opengl.tolist()})
    values = {
        "fl_x": fx,
        "fl_y": fy,
        "cx": cx + 0.5,
        "cy": cy + 0.5,
        "w": photos.width,
        "h": photos.height,
        "frames": frames,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(values | more))
    shutil.copytree(photos.folder, path.parent / "images", dirs_exist_ok=True)


def write_colmap_text(photos, folder):
    folder.mkdir(parents=True)
    fx, fy, cx, cy = pinhole(photos)
    (folder / "cameras.txt").write_text(
        f"# cameras\n1 PINHOLE {photos.width} {photos.height} {fx} {fy} {cx + 0.5} {cy + 0.5}\n"
    )
    lines = ["# images"]
    for number, (name, pose) in enumerate(zip(photos.names, photos.camera_from_world), 1):
        numbers = " ".join(repr(float(v)) for v in [*wxyz(pose), *pose[:3, 3]])
        lines += [f"{number} {numbers} 1 {name}", "" if number % 2 else "10.5 20.5 -1"]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")


def write_colmap_binary(photos, folder):
    folder.mkdir(parents=True)
    fx, fy, cx, cy = pinhole(photos)
    simple = struct.pack("<IiQQ4d", 7, 1, photos.width, photos.height, fx, fy, cx + 0.5, cy + 0.5)
    (folder / "cameras.bin").write_bytes(struct.pack("<Q", 1) + simple)
    data = struct.pack("<Q", len(photos.names))
    for number, (name, pose) in enumerate(zip(photos.names, photos.camera_from_world), 1):
        data += struct.pack("<I7dI", number, *wxyz(pose), *pose[:3, 3], 7) + name.encode() + b"\0"
        data += struct.pack("<Q", 2) + struct.pack("<ddqddq", 1, 2, -1, 3, 4, 5)
    (folder / "images.bin").write_bytes(data)


def write_camera(photos, path):
    fx, fy, cx, cy = pinhole(photos)
    values = {"width": photos.width, "height": photos.height, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    path.write_text(json.dumps(values))
    return path


FLANGE_FROM_CAMERA = np.eye(4)
FLANGE_FROM_CAMERA[:3, :3] = Rotation.from_euler("xyz", [10, -20, 95], degrees=True).as_matrix()
FLANGE_FROM_CAMERA[:3, 3] = 0.03, -0.05, 0.11
BASE_FROM_WORLD = np.eye(4)
BASE_FROM_WORLD[:3, :3] = Rotation.from_euler("xyz", [2, 1, 40], degrees=True).as_matrix()
BASE_FROM_WORLD[:3, 3] = 0.6, 0.1, -0.02


def write_robot(photos, path, unit=1.0, vectors=False):
    lines = ["image,x,y,z,..."]
    for name, pose in zip(photos.names, photos.camera_from_world):
        flange = BASE_FROM_WORLD @ np.linalg.inv(FLANGE_FROM_CAMERA @ pose)
        turn = Rotation.from_matrix(flange[:3, :3])
        values = [*(flange[:3, 3] / unit), *(turn.as_rotvec() if vectors else turn.as_quat())]
        lines.append(",".join([name, *(repr(float(v)) for v in values)]))
    path.write_text("\n".join(lines))
    return path


def flange_from_camera_words():
    """For --flange-from-camera, metres."""
    values = [*FLANGE_FROM_CAMERA[:3, 3], *Rotation.from_matrix(FLANGE_FROM_CAMERA[:3, :3]).as_quat()]
    return " ".join(repr(float(v)) for v in values)


def write_pairs(photos, folder, pairs):
    """`pairs` are numbers of left and right photos; no other relative pose than theirs is written."""
    write_camera(photos, folder / "camera.json")
    entries = []
    for left, right in pairs:
        right_from_left = photos.camera_from_world[right] @ np.linalg.inv(photos.camera_from_world[left])
        w, x, y, z = wxyz(right_from_left)
        relative = {"rotation_xyzw": [x, y, z, w], "translation_m": right_from_left[:3, 3].tolist()}
        entries.append({"left": photos.names[left], "right": photos.names[right], "right_from_left": relative})
    path = folder / "pairs.json"
    path.write_text(json.dumps({"left_camera": "camera.json", "right_camera": "camera.json", "pairs": entries}))
    return path
