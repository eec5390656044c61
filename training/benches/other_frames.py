"""What the frame costs in another room: the poses that `benches.from_photos --other` left in FOLDER, with the frame
told by each photo of that room in turn, and by all of them. Of views within ten degrees of a photo learned from.

    .venv/bin/python -m benches.other_frames FOLDER [--number OBJ_ID]
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benches.from_photos import directions, from_nearest_deg, from_object, read_estimates
from posed_train.metrics import rotation_error_deg, translation_error_m

NEAR_DEG = 10


def row(name: str, errors: list[tuple[float, float]]) -> str:
    degrees, metres = np.array(errors).T
    good = 100 * np.mean((degrees < 5) & (metres < 0.05))
    return f"| {name} | {len(errors)} | {good:.0f} % | {np.median(degrees):.1f} | {1000 * np.median(metres):.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--number", type=int, default=1)
    arguments = parser.parse_args()
    folder, number = arguments.folder, arguments.number
    truth = directions(folder / "splits/other/000000", number)
    photographed = from_object(list(directions(folder / "splits/learned/000000", number, 0.35).values()))
    views = json.loads((folder / "said.json").read_text())["views"]
    found = {image: pose for (_, image), pose in read_estimates(next((folder / "said").glob("*.csv")), number).items()}
    peaks = {v["image_id"]: v["evidence"]["peak"] for v in views if v["evidence"] and v["image_id"] in found}
    near = [image for image in peaks if from_nearest_deg(truth[image], photographed) < NEAR_DEG]
    offsets = {image: np.linalg.inv(found[image]) @ truth[image] for image in peaks}

    def errors(offset: np.ndarray, without: int | None = None) -> list[tuple[float, float]]:
        poses = [(found[image] @ offset, truth[image]) for image in near if image != without]
        return [(rotation_error_deg(*pair), translation_error_m(*pair)) for pair in poses]

    print("| frame told by | views | 5°5cm | degrees | mm |\n|---|---|---|---|---|")
    print(row("the photos learned from", errors(np.eye(4))))
    highest = max(peaks, key=peaks.__getitem__)
    print(row(f"photo {highest}, whose peaks are highest", errors(offsets[highest], highest)))
    each = {image: errors(offset, image) for image, offset in offsets.items()}
    print(row("each photo in turn", [one for some in each.values() for one in some]))
    best = max(each, key=lambda image: np.mean([turn < 5 and shift < 0.05 for turn, shift in each[image]]))
    print(row(f"photo {best}, which suits the others best", each[best]))
    common = np.eye(4)
    turns = [Rotation.from_matrix(offsets[image][:3, :3]).as_rotvec() for image in near]
    common[:3, :3] = Rotation.from_rotvec(np.median(turns, axis=0)).as_matrix()
    common[:3, 3] = np.median([offsets[image][:3, 3] for image in near], axis=0)
    print(row("these views themselves", errors(common)))


if __name__ == "__main__":
    main()
