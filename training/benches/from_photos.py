"""From two thirds of a scene's photos to bundles, by the commands of training/README.md; the other third scores them.
Prints the tables of docs/benchmarks/own-object.md.

    .venv/bin/python -m benches.from_photos SCENE MESHES --keep FOLDER [--backgrounds FOLDER] [--other SCENE]

The scene is BOP's, of the things on a board that `own_object` names; the commands see its photos alone. `--score` takes
the networks that are in FOLDER already. With `--photos` fewer are learned from, spread over the scene; the same third
is held out.
"""

import argparse
import csv
import json
import os
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np

from benches.own_object import OBJ_IDS, TAG_MM, command
from posed_train.bop import stated_pose
from posed_train.metrics import rotation_error_deg, translation_error_m

ROOT = Path(__file__).parents[2]
POSED, RUNTIME = ROOT / "target/release/posed", ROOT / ".onnxruntime/libonnxruntime.so"
OBJECTS = ("bottle", "crackers")
# Drawn by eye: x, y, w, h. Every third photo, from the second on, is held out.
DRAWN = {
    "bottle": {"000042": [902, 220, 227, 259], "000092": [858, 82, 113, 171], "000113": [209, 160, 181, 274]},
    "crackers": {"000043": [201, 97, 207, 248], "000092": [265, 105, 181, 277], "000020": [797, 291, 326, 300]},
}
REFERENCES = 16
NEAREST_DEG = (0, 5, 10, 20, 180)
WHOLE = 0.95


def thirds(scene: Path) -> tuple[list[str], list[str]]:
    """Names of the photos to learn from, and of those held out."""
    names = [path.name for path in sorted((scene / "rgb").iterdir())]
    return [name for k, name in enumerate(names) if k % 3 != 1], names[1::3]


def some_of(names: list[str], count: int, objects: list[str]) -> list[str]:
    """So many photos, spread over all; those on which a box of these objects is drawn are among them."""
    drawn = {f"{photo}.jpg" for name in objects for photo in DRAWN[name]}
    others = [name for name in names if name not in drawn]
    chosen = np.linspace(0, len(others) - 1, count - len(drawn)).round().astype(int)
    return sorted(drawn | {others[k] for k in chosen})


def learn(arguments: argparse.Namespace, used: list[str]) -> None:
    keep, objects = arguments.keep, arguments.objects
    photos, project = keep / "photos", keep / "project"
    photos.mkdir(parents=True)
    for name in used:
        os.symlink((arguments.scene / "rgb" / name).resolve(), photos / name)
    boxes = {n: {"boxes": {f"{photo}.jpg": box for photo, box in DRAWN[n].items()}} for n in objects}
    (keep / "boxes.json").write_text(json.dumps(boxes))
    options = ["--steps", arguments.steps, "--detector-steps", arguments.detector_steps, "--network", arguments.network]
    options += ["--threads", arguments.threads] if arguments.threads else []
    print(f"{len(used)} photos\n\n| minutes | clock | CPUs |\n|---|---|---|")
    for words in (
        ("new", project, photos, "--tag-mm", TAG_MM, "--objects", *objects),
        ("label", project, "--box", keep / "boxes.json"),
        ("check", project),
        ("train", project, "--models", keep / "models", *options),
        ("export", project, "--models", keep / "models", "--out", keep),
    ):
        if words[0] == "train" and arguments.backgrounds:
            shutil.copytree(arguments.backgrounds, project / "backgrounds")
        clock, cpu = command(*words)
        print(f"| `{words[0]}` | {clock / 60:.1f} | {cpu / 60:.1f} |", flush=True)


def numbers(arguments: argparse.Namespace) -> dict[str, int]:
    """That the project gave its objects."""
    manifests = {name: arguments.keep / "models" / name / "object.json" for name in arguments.objects}
    return {name: json.loads(path.read_text())["obj_id"] for name, path in manifests.items()}


def renumbered(scene: Path, names: list[str] | None, of: dict[str, int], out: Path) -> Path:
    """Some photos of a scene, with these numbers of its objects."""
    shutil.rmtree(out, ignore_errors=True)
    (out / "rgb").mkdir(parents=True)
    new_ids = {OBJ_IDS[name]: number for name, number in of.items()}
    tables = {name: json.loads((scene / f"scene_{name}.json").read_text()) for name in ("camera", "gt", "gt_info")}
    files = {key: f"{int(key):06d}.jpg" for key in tables["gt"]}
    kept = [key for key, file in files.items() if names is None or file in names]
    for key in kept:
        os.symlink((scene / "rgb" / files[key]).resolve(), out / "rgb" / files[key])
        tables["gt"][key] = [one | {"obj_id": new_ids.get(one["obj_id"], 99)} for one in tables["gt"][key]]
    for name, table in tables.items():
        (out / f"scene_{name}.json").write_text(json.dumps({key: table[key] for key in kept}))
    return out


def seen_whole(scene: Path, number: int) -> list[str]:
    gt, info = (json.loads((scene / f"scene_{name}.json").read_text()) for name in ("gt", "gt_info"))
    return [
        key for key in gt if any(a["obj_id"] == number and b["visib_fract"] > WHOLE for a, b in zip(gt[key], info[key]))
    ]


def evaluate(name: str, number: int, learned: Path, split: Path, arguments: argparse.Namespace) -> list[dict]:
    """What is said of each view. The frame is the truth's, told by photos that were learned from."""
    common = ["--models", arguments.keep / "models", "--reference", arguments.keep / "truth", "--threads", 1]
    photos = seen_whole(learned, number)
    chosen = [word for key in photos[:: max(1, len(photos) // REFERENCES)][:REFERENCES] for word in ("--image", key)]
    run(arguments.posed, "calibrate", name, "--scene", learned, *chosen, *common)
    out, meshes = arguments.keep / "said", arguments.keep / "meshes"
    shutil.rmtree(out, ignore_errors=True)
    words = ("--split", split, "--meshes", meshes, "--visible", "0.7..1", "--json", f"{out}.json", "--bop", out)
    run(arguments.posed, "evaluate", name, *words, *common)
    estimates = read_estimates(next(out.glob("*.csv")), number)
    views = json.loads(Path(f"{out}.json").read_text())["views"]
    return [view | {"estimate": estimates.get((int(view["scene"]), view["image_id"]))} for view in views]


def copy_meshes(folder: Path, of: dict[str, int], out: Path) -> None:
    out.mkdir(exist_ok=True)
    info = json.loads((folder / "models_info.json").read_text())
    new = {}
    for name, number in of.items():
        new[str(number)] = info[str(OBJ_IDS[name])]
        shutil.copy(folder / f"obj_{OBJ_IDS[name]:06d}.ply", out / f"obj_{number:06d}.ply")
    (out / "models_info.json").write_text(json.dumps(new))


def run(*words) -> None:
    environment = {"ORT_DYLIB_PATH": str(RUNTIME)} | os.environ
    subprocess.run(list(map(str, words)), check=True, stdout=subprocess.DEVNULL, env=environment)


def read_estimates(path: Path, number: int) -> dict[tuple[int, int], np.ndarray]:
    """`camera_from_object` by scene and image."""
    found = {}
    for row in csv.DictReader(path.open()):
        if int(row["obj_id"]) == number:
            entry = {
                "cam_R_m2c": [float(v) for v in row["R"].split()],
                "cam_t_m2c": [float(v) for v in row["t"].split()],
            }
            found[int(row["scene_id"]), int(row["im_id"])] = stated_pose(entry, "m2c")
    return found


def directions(scene: Path, number: int, least_visible: float = 0.0) -> dict[int, np.ndarray]:
    """Poses `camera_from_object` by image."""
    gt, info = (json.loads((scene / f"scene_{name}.json").read_text()) for name in ("gt", "gt_info"))
    return {
        int(key): stated_pose(one, "m2c")
        for key in gt
        for one, seen in zip(gt[key], info[key])
        if one["obj_id"] == number and seen["visib_fract"] >= least_visible
    }


def from_object(poses: list[np.ndarray]) -> np.ndarray:
    """Directions `[N, 3]` in which the object sees the cameras."""
    places = np.stack([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])
    return places / np.linalg.norm(places, axis=1, keepdims=True)


def from_nearest_deg(pose: np.ndarray, photographed: np.ndarray) -> float:
    """Degrees between the direction of a view and the nearest of these."""
    return float(np.degrees(np.arccos(np.clip((from_object([pose]) @ photographed.T).max(), -1, 1))))


def table(name: str, number: int, learned: Path, scene: Path, views: list[dict]) -> None:
    photographed = from_object(list(directions(learned, number, 0.35).values()))
    truth = directions(scene, number)
    rows = []
    for view in views:
        true, found = truth[view["image_id"]], view["estimate"]
        nearest = from_nearest_deg(true, photographed)
        if found is None:
            rows.append((nearest, np.inf, np.inf, np.nan))
            continue
        ray = true[:3, 3] / np.linalg.norm(true[:3, 3])
        depth = 1000 * float((found[:3, 3] - true[:3, 3]) @ ray)
        rows.append((nearest, rotation_error_deg(found, true), 1000 * translation_error_m(found, true), depth))
    rows = np.array(rows)
    limits = [(0, 180), *pairwise(NEAREST_DEG)]
    for low, high in limits:
        some = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if not len(some):
            continue
        good = np.mean((some[:, 1] < 5) & (some[:, 2] < 50))
        where = "all" if (low, high) == limits[0] else f"{low} to {high}" if high < 180 else f"{low} and more"
        print(
            f"| {name} | {where} | {len(some)} | {100 * good:.0f} % | {np.median(some[:, 1]):.1f} | "
            f"{np.median(some[:, 2]):.1f} | {np.nanmedian(some[:, 3]):+.1f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path, help="BOP scene: only its photos are given to the commands")
    parser.add_argument("meshes", type=Path, help="BOP models folder, to score")
    parser.add_argument("--keep", type=Path, required=True, help="where the project goes, and the networks")
    parser.add_argument("--score", action="store_true", help="what is in --keep already")
    parser.add_argument("--objects", nargs="+", default=OBJECTS, choices=OBJECTS, help="to learn and to score")
    parser.add_argument("--other", type=Path, help="another scene, to score by")
    parser.add_argument("--backgrounds", type=Path, help="photos for the project's backgrounds")
    parser.add_argument("--photos", type=int, help="to learn from; all but the held-out third, if not given")
    parser.add_argument("--all", action="store_true", help="learn from all photos, none is held out: for --other")
    parser.add_argument("--network", default="lite0", help="of the keypoint nets")
    parser.add_argument("--threads", type=int, help="of each training")
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--detector-steps", type=int, default=600)
    parser.add_argument("--posed", type=Path, default=POSED)
    arguments = parser.parse_args()
    used, held_out = thirds(arguments.scene)
    if arguments.all:
        used, held_out = sorted(used + held_out), []
    if arguments.photos is not None:
        used = some_of(used, arguments.photos, arguments.objects)
    if not arguments.score:
        learn(arguments, used)
    splits, of = arguments.keep / "splits", numbers(arguments)
    copy_meshes(arguments.meshes, of, arguments.keep / "meshes")
    learned = renumbered(arguments.scene, used, of, splits / "learned/000000")
    scored = {}
    if held_out:
        scored["held out"] = renumbered(arguments.scene, held_out, of, splits / "held-out/000000")
    if arguments.other:
        scored["other"] = renumbered(arguments.other, None, of, splits / "other/000000")
    for what, scene in scored.items():
        print(f"\n| {what} | degrees to the nearest photo | views | 5°5cm | degrees | mm | depth, mm |")
        print("|---|---|---|---|---|---|---|")
        for name, number in of.items():
            try:
                views = evaluate(name, number, learned, scene.parent, arguments)
            except subprocess.CalledProcessError:  # it has said why: a network too poor to be tied to the truth's frame
                print(f"| {name} | all | | no reference | | | |")
                continue
            table(name, number, learned, scene, views)


if __name__ == "__main__":
    main()
