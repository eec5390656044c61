"""The plots of a report, each a PNG."""

import csv
import io
from pathlib import Path

import matplotlib
import numpy as np

from .judged import Judgement

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib import ticker

LEARNED, JUDGED, WRONG, ARROW = "#9aa4ad", "#0b5cad", "#b00020", "#d07000"
DPI = 110


def as_png(figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=DPI, bbox_inches="tight", metadata={"Software": None})
    plt.close(figure)
    return out.getvalue()


def directions(found: Judgement, scene: str) -> bytes:
    """From where the photos see the object, which were held out, and where photos are missing; seen from above."""
    seen = found.seen[scene]
    figure, axes = plt.subplots(figsize=(4.4, 4.6), subplot_kw={"projection": "polar"})
    axes.scatter(np.radians(seen.azimuth_deg), 90 - seen.elevation_deg, s=12, color=LEARNED, label="learned from")
    mine = [one for one in found.held_out if one.view.scene == scene]
    for agrees, colour, label in ((True, JUDGED, "held out"), (False, WRONG, "held out, does not agree")):
        some = [one for one in mine if one.deviation.agrees == agrees]
        if some:
            angles = np.radians([one.azimuth_deg for one in some])
            axes.scatter(angles, [90 - one.elevation_deg for one in some], s=34, color=colour, label=label, zorder=3)
    for azimuth, elevation in seen.missing():
        angle, radius = np.radians(azimuth), 90 - elevation
        arrow = {"arrowstyle": "->", "color": ARROW, "lw": 1.4}
        axes.annotate("", (angle, radius - 9), (angle, radius + 6), arrowprops=arrow)
    if seen.missing():
        axes.plot([], [], color=ARROW, label="add photos from here")
    axes.set_rlim(0, 90)
    axes.set_rgrids([30, 60, 90], ["60°", "30°", "0°"], fontsize=8)
    axes.tick_params(labelsize=8)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.28), ncols=2, fontsize=8, frameon=False)
    return as_png(figure)


def errors(found: Judgement) -> bytes:
    """Of each held-out photo, over distance and height."""
    figure, rows = plt.subplots(2, 2, figsize=(7.4, 4.6), sharey="row", layout="constrained")
    compared = [one for one in found.held_out if one.deviation.compared]
    for row, values, unit in ((rows[0], "degrees", "degrees"), (rows[1], "millimetres", "mm")):
        for axes, over, label in ((row[0], "distance_m", "distance, m"), (row[1], "elevation_deg", "height, degrees")):
            for agrees, colour in ((True, JUDGED), (False, WRONG)):
                some = [one for one in compared if one.deviation.agrees == agrees]
                axes.scatter([getattr(o, over) for o in some], [getattr(o, values) for o in some], s=16, color=colour)
            axes.set_xlabel(label)
            if compared:
                in_decades(axes)
            axes.grid(alpha=0.3)
        row[0].set_ylabel(unit)
    return as_png(figure)


def in_decades(axes) -> None:
    """A logarithmic scale with numbers as people write them."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axes.yaxis.set_minor_formatter(ticker.NullFormatter())


def curves(run: Path) -> bytes | None:
    """Loss and held-out figures of a training over its steps."""
    try:
        with (run / "log.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
    except OSError:
        return None
    figure, panels = plt.subplots(1, 3, figsize=(9.6, 2.8), layout="constrained")
    wanted = (
        ("training loss", [("loss", "")]),
        ("held-out keypoints, px", [("held_out_keypoint_px", "")]),
        ("held-out spread", [("spread_degrees", "degrees"), ("spread_mm", "mm")]),
    )
    for axes, (title, columns) in zip(panels, wanted):
        for column, label in columns:
            points = [(int(row["step"]), float(row[column])) for row in rows if row.get(column)]
            if points:
                axes.plot(*zip(*points), label=label, marker="." if len(points) < 4 else "")
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("step")
        axes.grid(alpha=0.3)
        if len(columns) > 1 and axes.get_lines():
            in_decades(axes)
            axes.legend(fontsize=8)
    return as_png(figure)
