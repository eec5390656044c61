"""How many boxes detectors see in photos that show none of their objects, by threshold. Prints a table.

    .venv/bin/python -m benches.false_boxes PHOTOS DETECTOR.onnx...

PHOTOS is a folder of *.jpg, of which the last `--last` by name are taken.
"""

import argparse
from pathlib import Path

import numpy as np

from posed_train.bop import read_rgb
from posed_train.detector import letterbox
from posed_train.exported import session

THRESHOLDS = 0.4, 0.45, 0.5, 0.6
SCORE = 4
"""Column of the detector's rows."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path)
    parser.add_argument("detectors", type=Path, nargs="+")
    parser.add_argument("--last", type=int, default=64)
    arguments = parser.parse_args()
    photos = [letterbox(read_rgb(path))[0] for path in sorted(arguments.photos.glob("*.jpg"))[-arguments.last :]]
    print(f"| detector | {' | '.join(f'above {value}' for value in THRESHOLDS)} | of {len(photos)} photos |")
    print("|---|" + "---|" * len(THRESHOLDS) + "---|")
    for path in arguments.detectors:
        net = session(path)
        rows = [net.run(["detections"], {"image": photo[None]})[0][0] for photo in photos]
        scores = np.concatenate([found[:, SCORE] for found in rows])
        print(f"| {path} | {' | '.join(str((scores > value).sum()) for value in THRESHOLDS)} | |", flush=True)


if __name__ == "__main__":
    main()
