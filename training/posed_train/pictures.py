"""What a training looks like: its curves, and a sheet of crops with their keypoints."""

import csv
from pathlib import Path

import cv2
import matplotlib
import numpy as np

from .bop import View
from .crops import first_crop
from .validate import Predictor

matplotlib.use("Agg")
import matplotlib.pyplot as plt

COLUMNS = (
    "step",
    "seconds",
    "loss",
    "add_percent",
    "proj5_percent",
    "deg5_cm5_percent",
    "rotation_median_deg",
    "translation_median_mm",
    "keypoint_median_px",
    "scale_median_percent",
    "held_out_deg5_cm5_percent",
    "held_out_keypoint_px",
    "held_out_photos",
    "agreeing",
    "spread_degrees",
    "spread_mm",
)
SHEET = (4, 6)  # rows, columns
PREDICTED, TRUE = (60, 220, 60), (230, 60, 60)


class Log:
    """`log.csv`, one line for each checkpoint; a training that goes on appends to it."""

    def __init__(self, path: Path):
        self.path = path
        if not path.exists():
            with path.open("w", newline="") as file:
                csv.DictWriter(file, COLUMNS).writeheader()

    def write(self, row: dict[str, float]) -> None:
        with self.path.open("a", newline="") as file:
            csv.DictWriter(file, COLUMNS, extrasaction="ignore").writerow(row)

    def read(self) -> list[dict[str, str]]:
        with self.path.open(newline="") as file:
            return list(csv.DictReader(file))


def draw_curves(log: Log, out: Path) -> None:
    """Loss, shares of good poses, median errors of keypoints, and how far poses lie from each other, over the steps."""
    rows = log.read()
    figure, (loss, shares, errors, apart) = plt.subplots(1, 4, figsize=(16, 3.6), layout="constrained")

    def curve(axes, column: str, label: str) -> None:
        # A log of an older version lacks some columns.
        points = [(int(row["step"]), float(row[column])) for row in rows if row.get(column)]
        if points:
            axes.plot(*zip(*points), label=label)

    curve(loss, "loss", "training loss")
    for column, label in (("add_percent", "ADD(-S)"), ("proj5_percent", "Proj-5"), ("deg5_cm5_percent", "5°5cm")):
        curve(shares, column, label)
    curve(shares, "held_out_deg5_cm5_percent", "5°5cm, held out")
    curve(errors, "held_out_keypoint_px", "keypoints, held out, px")
    curve(errors, "keypoint_median_px", "keypoints, px")
    curve(errors, "scale_median_percent", "their common scale, %")
    curve(apart, "spread_degrees", "poses, held out, degrees")
    curve(apart, "spread_mm", "mm")
    for axes, unit in ((loss, "loss"), (shares, "% of views"), (errors, "median error"), (apart, "median spread")):
        axes.set_xlabel("step")
        axes.set_ylabel(unit)
        axes.grid(alpha=0.3)
    shares.set_ylim(0, 100)
    for axes in (shares, errors, apart):
        if axes.get_lines():
            axes.legend()
    if apart.get_lines():
        apart.set_yscale("log")
    figure.savefig(out, dpi=90)
    plt.close(figure)


def draw_sheet(predictor: Predictor, views: list[View], truth: np.ndarray, out: Path) -> None:
    """Crops of views spread over the set, with the net's keypoints (green) tied to the true ones (red).

    `truth` is `[V, symmetries, N, 2]` image pixels.
    """
    rows, columns = SHEET
    chosen = np.unique(np.linspace(0, len(views) - 1, rows * columns).astype(int))
    tiles = []
    for index in chosen:
        crop, square = first_crop(views[index], predictor.size)
        found = predictor.run(crop[None])[0][0]
        alike = square.to_crop(truth[index], predictor.size)
        expected = alike[np.linalg.norm(alike - found, axis=-1).mean(-1).argmin()]
        tile = cv2.resize(crop, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
        for there, here in zip((2 * expected + 0.5).round().astype(int), (2 * found + 0.5).round().astype(int)):
            cv2.line(tile, tuple(map(int, there)), tuple(map(int, here)), TRUE, 1, cv2.LINE_AA)
            cv2.circle(tile, tuple(map(int, there)), 2, TRUE, -1, cv2.LINE_AA)
            cv2.circle(tile, tuple(map(int, here)), 2, PREDICTED, -1, cv2.LINE_AA)
        tiles.append(tile)
    blank = np.zeros_like(tiles[0])
    tiles += [blank] * (-len(tiles) % columns)
    sheet = np.vstack([np.hstack(tiles[first : first + columns]) for first in range(0, len(tiles), columns)])
    cv2.imwrite(str(out), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))
