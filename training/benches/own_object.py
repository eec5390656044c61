"""Scores `new` and `label --box` on photos of things on a board whose truth is known: a BOP scene, of which the
commands see the photos alone. Prints a table for docs/benchmarks/own-object.md.

    .venv/bin/python -m benches.own_object SCENE [--keep FOLDER]
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benches import formats
from benches.poses import differences, scene_poses
from posed_train.bop import stated_pose
from posed_train.onboard.outlines import box_overlap

TAG_MM = 50
# Drawn by eye in three photos each: x, y, w, h.
DRAWN = {
    "bottle": {"000041": [789, 230, 164, 310], "000092": [858, 82, 113, 171], "000113": [209, 160, 181, 274]},
    "crackers": {"000041": [139, 65, 282, 266], "000092": [265, 105, 181, 277], "000020": [797, 291, 326, 300]},
    "cube": {"000041": [454, 404, 123, 134], "000092": [747, 274, 63, 80], "000020": [560, 155, 74, 86]},
}
OBJ_IDS = {"bottle": 3, "crackers": 2, "cube": 1}
BOXES_FROM, MASKS_FROM = 0.7, 0.9
"""Least visible fraction."""


@dataclass(frozen=True)
class Truth:
    folder: Path  # of the photos
    names: list[str]
    camera_from_world: list[np.ndarray]
    matrix: np.ndarray
    width: int
    height: int


def read_truth(scene: Path) -> Truth:
    cameras = json.loads((scene / "scene_camera.json").read_text())
    names = [path.name for path in sorted((scene / "rgb").iterdir())]
    entries = [cameras[str(int(Path(name).stem))] for name in names]
    height, width = cv2.imread(str(scene / "rgb" / names[0])).shape[:2]
    poses = [stated_pose(entry, "w2c") for entry in entries]
    return Truth(scene / "rgb", names, poses, np.array(entries[0]["cam_K"]).reshape(3, 3), width, height)


def command(*words) -> tuple[float, float]:
    """Seconds on the clock and of the CPUs."""
    started, before = time.time(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [Path(sys.executable).parent / "posed-train", *map(str, words)], check=True, stdout=subprocess.DEVNULL
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.time() - started, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def print_differences(of: str, degrees: np.ndarray, millimetres: np.ndarray) -> None:
    print(f"| {of} | median | worst |\n|---|---|---|")
    print(f"| rotation, degrees | {np.median(degrees):.3f} | {degrees.max():.3f} |")
    print(f"| place after scale, mm | {np.median(millimetres):.2f} | {millimetres.max():.2f} |")


def score_cameras(project: Path, truth: Truth) -> None:
    found = scene_poses(project / "train/000000")
    degrees, millimetres, scale = differences([found[name] for name in truth.names], truth.camera_from_world)
    print_differences("camera poses", degrees, millimetres)
    print(f"\nScale from the tags' side alone: {100 * (scale - 1):+.2f} %.")
    camera = json.loads((project / "train/000000/scene_camera.json").read_text())["0"]
    off = np.array(camera["cam_K"]).reshape(3, 3) - truth.matrix
    percent = 100 * np.abs(np.diag(off)[:2] / np.diag(truth.matrix)[:2]).max()
    print(
        f"K: fx {off[0, 0]:+.2f}, fy {off[1, 1]:+.2f}, cx {off[0, 2]:+.2f}, cy {off[1, 2]:+.2f} px ({percent:.2f} %).\n"
    )


def score_labels(project: Path, scene: Path) -> None:
    ours, folder = project / "train/000000", scene
    names, info = (json.loads((ours / f"{name}.json").read_text()) for name in ("photos", "scene_gt_info"))
    gt, true = (json.loads((folder / f"scene_{name}.json").read_text()) for name in ("gt", "gt_info"))
    print("| IoU, median / 10th percentile | boxes | masks |\n|---|---|---|")
    for index, (name, obj_id) in enumerate(OBJ_IDS.items()):
        boxes, masks = [], []
        for key, photo in names.items():
            number = int(Path(photo).stem)
            row = [entry["obj_id"] for entry in gt[str(number)]]
            if obj_id not in row:
                continue
            place = row.index(obj_id)
            entry = true[str(number)][place]
            if entry["visib_fract"] >= BOXES_FROM:
                boxes.append(box_overlap(edges(entry["bbox_visib"]), edges(info[key][index]["bbox_visib"])))
            if entry["visib_fract"] >= MASKS_FROM:
                a = cv2.imread(str(folder / f"mask_visib/{number:06d}_{place:06d}.png"), 0) > 0
                b = cv2.imread(str(ours / f"mask_visib/{int(key):06d}_{index:06d}.png"), 0) > 0
                masks.append((a & b).sum() / (a | b).sum())
        cells = [f"{np.median(v):.3f} / {np.percentile(v, 10):.3f} ({len(v)})" for v in (boxes, masks)]
        print(f"| {name} | {' | '.join(cells)} |")


def edges(box: list[int]) -> np.ndarray:
    x, y, w, h = box
    return np.array([x, y, x + w - 1, y + h - 1])


def score_importers(truth: Truth, scene: Path, folder: Path) -> None:
    print("\n| importer | degrees, worst | mm, worst |\n|---|---|---|")
    formats.write_transforms(truth, folder / "nerf/transforms.json")
    formats.write_colmap_text(truth, folder / "text")
    formats.write_colmap_binary(truth, folder / "binary")
    rows, camera = formats.write_robot(truth, folder / "rows.csv"), formats.write_camera(truth, folder / "camera.json")
    told = formats.flange_from_camera_words()
    metres = ("--unit-mm", 1000)
    for name, words in {
        "nerfstudio": ("--transforms", folder / "nerf/transforms.json", *metres),
        "COLMAP, text": (truth.folder, "--colmap", folder / "text", *metres),
        "COLMAP, binary": (truth.folder, "--colmap", folder / "binary", *metres),
        "robot": (truth.folder, "--poses", rows, "--camera", camera, "--flange-from-camera", told),
        "BOP": ("--bop", scene, "--objects", *sorted(OBJ_IDS, key=OBJ_IDS.get)),
    }.items():
        project = folder / f"by-{name.lower().replace(', ', '-')}"
        command("new", project, *words)
        found = scene_poses(project / "train/000000")
        degrees, millimetres, scale = differences([found[n] for n in truth.names], truth.camera_from_world)
        shift = np.abs(millimetres).max() + 1000 * abs(scale - 1)
        print(f"| {name} | {degrees.max():.6f} | {shift:.6f} |")


def score_pairs(truth: Truth, folder: Path) -> None:
    """Of photos that follow each other, no two pairs of one: what `new` joins them to."""
    pairs = [(k, k + 1) for k in range(0, len(truth.names) - 1, 2)]
    file = formats.write_pairs(truth, folder, pairs)
    clock, cpu = command("new", folder / "by-pairs", truth.folder, "--pairs", file)
    found = scene_poses(folder / "by-pairs/train/000000")
    true = dict(zip(truth.names, truth.camera_from_world))
    degrees, millimetres, scale = differences(list(found.values()), [true[name] for name in found])
    print(
        f"\n{len(pairs)} pairs, {len(found) // 2} of them in one component after {clock:.0f} s ({cpu:.0f} of the CPUs)"
    )
    print_differences("pairs", degrees, millimetres)
    print(f"\nScale: {100 * (scale - 1):+.2f} %.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path, help="BOP scene: only its photos are given to the commands")
    parser.add_argument("--keep", type=Path, help="where to leave the project")
    arguments = parser.parse_args()
    truth = read_truth(arguments.scene)
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        values = {n: {"boxes": {f"{photo}.jpg": box for photo, box in boxes.items()}} for n, boxes in DRAWN.items()}
        (folder / "boxes.json").write_text(json.dumps(values))
        project = folder / "project"
        print(
            f"{len(truth.names)} photos of {truth.width}x{truth.height} px\n\n| seconds | clock | CPUs |\n|---|---|---|"
        )
        for name, words in {
            "new": ("new", project, truth.folder, "--tag-mm", TAG_MM, "--objects", *DRAWN),
            "label --box": ("label", project, "--box", folder / "boxes.json"),
            "check": ("check", project),
        }.items():
            clock, cpu = command(*words)
            print(f"| `{name}` | {clock:.0f} | {cpu:.0f} |", flush=True)
        print()
        score_cameras(project, truth)
        score_labels(project, arguments.scene)
        score_importers(truth, arguments.scene, folder)
        score_pairs(truth, folder)


if __name__ == "__main__":
    main()
