"""Calibrates an object by the one image, of scenes that its net has not learned from, whose offset is nearest to what
all of them say together: as that in `demo/cameras` was chosen. Not for symmetric objects, whose offsets are several.

    .venv/bin/python -m benches.choose_reference cube --split DATA/rendered/train --models ../models --out ../reference
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benches.from_photos import POSED, run
from posed_train.bop import read_json
from posed_train.metrics import rotation_error_deg
from posed_train.onboard.from_pairs import read_relative
from posed_train.spread import middle_pose

LEAST_VISIBLE = 0.95


def candidates(split: Path, obj_id: int, scenes: int) -> list[tuple[Path, str]]:
    """Scenes and images that show all of the object."""
    found = []
    for scene in sorted(path for path in split.iterdir() if path.is_dir())[-scenes:]:
        truth, info = read_json(scene / "scene_gt.json"), read_json(scene / "scene_gt_info.json")
        for key in truth:
            of_it = [two["visib_fract"] for one, two in zip(truth[key], info[key]) if one["obj_id"] == obj_id]
            if len(of_it) == 1 and of_it[0] >= LEAST_VISIBLE:
                found.append((scene, key))
    return found


def calibrate(name: str, scene: Path, image: str, models: Path, out: Path) -> np.ndarray:
    """The offset `object_from_keypoints` that one image gives."""
    words = ("calibrate", name, "--scene", scene, "--image", image, "--models", models, "--reference", out)
    run(POSED, *words, "--threads", 1)
    stated = json.loads((out / f"{name}.json").read_text())["object_from_keypoints"]
    return read_relative(stated, name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name")
    parser.add_argument("--split", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=6, help="the last ones, that the net has not learned from")
    parser.add_argument("--models", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="folder of references")
    arguments = parser.parse_args()
    manifest = json.loads((arguments.models / arguments.name / "object.json").read_text())
    offsets = {}
    with tempfile.TemporaryDirectory() as folder:
        for scene, image in candidates(arguments.split, manifest["obj_id"], arguments.scenes):
            try:
                offsets[scene, image] = calibrate(arguments.name, scene, image, arguments.models, Path(folder))
            except subprocess.CalledProcessError:
                print(f"{scene.name}/{image}: refused, see above")
    middle = middle_pose(np.stack(list(offsets.values())))
    radius_mm = 500 * manifest["diameter_m"]

    def off_mm(offset: np.ndarray) -> float:
        """By how much a point on the object's surface moves at most."""
        turned = np.radians(rotation_error_deg(offset, middle)) * radius_mm
        return turned + 1000 * float(np.linalg.norm(offset[:3, 3] - middle[:3, 3]))

    chosen = min(offsets, key=lambda key: off_mm(offsets[key]))
    calibrate(arguments.name, *chosen, arguments.models, arguments.out)
    spread = np.median([off_mm(offset) for offset in offsets.values()])
    image = "/".join([chosen[0].name, chosen[1]])
    print(
        f"{arguments.name}: {image} of {len(offsets)} images, {off_mm(offsets[chosen]):.1f} mm off their middle; "
        f"{spread:.1f} mm in the median"
    )


if __name__ == "__main__":
    main()
