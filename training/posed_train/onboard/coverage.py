"""What `new` says of the photos: a table, a contact sheet, and from where they were taken."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt

BANDS_DEG = (0, 30, 60, 90)
SECTORS = (12, 12, 4)
"""Of each band."""
THUMBNAIL = 240, 160
SHEET_COLUMNS = 8
MAX_THUMBNAILS = 160


@dataclass(frozen=True)
class Row:
    """Of one photo."""

    name: str
    tags: int
    residual_px: float | None
    sharpness: float  # as a share of the median


@dataclass(frozen=True)
class Coverage:
    """From where photos look at the middle of a scene."""

    azimuth_deg: np.ndarray  # [V]
    elevation_deg: np.ndarray  # [V]
    distance_m: np.ndarray  # [V]

    def counts(self) -> list[np.ndarray]:
        """Photos in each sector of each band."""
        counts = []
        for low, high, sectors in zip(BANDS_DEG, BANDS_DEG[1:], SECTORS):
            inside = (self.elevation_deg >= low) & (self.elevation_deg < high + (high == 90))
            counts.append(np.histogram(self.azimuth_deg[inside] % 360, sectors, (0, 360))[0])
        return counts

    def missing(self) -> list[tuple[float, float]]:
        """Azimuth and elevation of the middles of empty sectors, degrees."""
        return [
            ((sector + 0.5) * 360 / len(band), (low + high) / 2)
            for low, high, band in zip(BANDS_DEG, BANDS_DEG[1:], self.counts())
            for sector in np.flatnonzero(band == 0)
        ]

    @property
    def share(self) -> float:
        return 1 - len(self.missing()) / sum(SECTORS)


def coverage(camera_from_world: Sequence[np.ndarray], centre: np.ndarray, up: np.ndarray) -> Coverage:
    """`centre` and `up`, a unit vector, in the world."""
    poses = np.stack(camera_from_world)
    towards = -np.einsum("vji,vj->vi", poses[:, :3, :3], poses[:, :3, 3]) - centre
    across = np.cross(up, [0, 0, 1.0] if abs(up[2]) < 0.9 else [0, 1.0, 0])
    across /= np.linalg.norm(across)
    x, y, z = towards @ across, towards @ np.cross(up, across), towards @ up
    distance = np.linalg.norm(towards, axis=1)
    return Coverage(np.degrees(np.arctan2(y, x)) % 360, np.degrees(np.arcsin(np.clip(z / distance, -1, 1))), distance)


def table(rows: Sequence[Row], seen: Coverage) -> str:
    """A few lines, however many photos."""
    columns = (
        ("tags", [row.tags for row in rows], "{:.0f}"),
        ("residual, px", [row.residual_px for row in rows if row.residual_px is not None], "{:.2f}"),
        ("sharpness / median", [row.sharpness for row in rows], "{:.2f}"),
        ("distance, m", seen.distance_m, "{:.2f}"),
        ("height, degrees", seen.elevation_deg, "{:.0f}"),
    )
    lines = [f"{f'{len(seen.distance_m)} photos':<20}    least    median      most"]
    for name, values, form in columns:
        if len(values):
            least, median, most = (form.format(f(values)) for f in (np.min, np.median, np.max))
            lines.append(f"{name:<20}{least:>9} {median:>9} {most:>9}")
    lines.append(f"directions covered  {seen.share:>9.0%}  (of {sum(SECTORS)} sectors above the horizon)")
    return "\n".join(lines)


def draw_coverage(seen: Coverage, path: Path) -> None:
    """A view from above: the middle is straight down on the object, the rim level with it."""
    figure, axes = plt.subplots(figsize=(6, 6.4), subplot_kw={"projection": "polar"})
    axes.scatter(np.radians(seen.azimuth_deg), 90 - seen.elevation_deg, s=14, label="photos")
    for azimuth, elevation in seen.missing():
        angle, radius = np.radians(azimuth), 90 - elevation
        arrow = {"arrowstyle": "->", "color": "tab:red", "lw": 1.5}
        axes.annotate("", (angle, radius - 9), (angle, radius + 6), arrowprops=arrow)
    axes.plot([], [], color="tab:red", label="photograph from here, too")
    axes.set_rlim(0, 90)
    axes.set_rgrids([30, 60, 90], ["60°", "30°", "0°"])
    axes.set_title("From where the photos look (degrees above the horizon)", pad=16)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)


def thumbnail(image: np.ndarray, text: str, bad: bool = False) -> np.ndarray:
    """BGR, fitted into THUMBNAIL with its name."""
    width, height = THUMBNAIL
    scale = min(width / image.shape[1], height / image.shape[0])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[:height, :width]
    canvas = np.full((height, width, 3), 32, np.uint8)
    canvas[: small.shape[0], : small.shape[1]] = small
    for colour, thickness in (((0, 0, 0), 3), ((80, 80, 255) if bad else (255, 255, 255), 1)):
        cv2.putText(canvas, text[-28:], (5, height - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, thickness, cv2.LINE_AA)
    return canvas


def draw_sheet(thumbnails: Sequence[np.ndarray], path: Path) -> None:
    chosen = list(thumbnails)[:: max(1, -(-len(thumbnails) // MAX_THUMBNAILS))]
    chosen += [np.zeros_like(chosen[0])] * (-len(chosen) % SHEET_COLUMNS)
    rows = [np.hstack(chosen[k : k + SHEET_COLUMNS]) for k in range(0, len(chosen), SHEET_COLUMNS)]
    if not cv2.imwrite(str(path), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 85]):
        raise OSError(f"{path}: cannot write the picture; is the disk full?")
