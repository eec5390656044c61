"""Trains one object's net in several ways, for the same number of steps: a table of what each part is worth."""

import json
import time
from dataclasses import replace
from pathlib import Path

from .check import check
from .config import KeypointConfig
from .data import read_photoreal
from .train import train

VARIANTS = {
    "component loss, cube of 8 keypoints, Fuse": {},
    "pairwise loss: registration and consistency": {"loss": "pairwise"},
    "pairwise loss: registration alone": {"loss": "registration"},
    "without Fuse (no other backgrounds)": {"masks": False},
    "tetrahedron, 4 keypoints": {"keypoint_shape": "tetrahedron"},
    "octahedron, 6 keypoints": {"keypoint_shape": "octahedron"},
    "icosahedron, 12 keypoints": {"keypoint_shape": "icosahedron"},
    "r-sphere, 8 keypoints": {"keypoint_shape": "r-sphere"},
    "r-volume, 8 keypoints": {"keypoint_shape": "r-volume"},
}
"""The paper's ablations (tables 3 to 5), and the component loss beside its pairwise one."""


def run(config: KeypointConfig, data: Path, runs: Path, numbers: list[int]) -> None:
    """Trains some of the variants (numbered from 0) that have no result yet."""
    check(read_photoreal(config, data), config.poses)
    for number in numbers:
        name, change = list(VARIANTS.items())[number]
        out = runs / f"{config.name}_ablation_{number}"
        result = out / "result.json"
        if result.exists():
            continue
        started = time.time()
        settings = replace(config, **change)
        scores = train(settings, data, out).scores
        seconds = time.time() - started
        result.write_text(json.dumps({"name": name, "steps": settings.steps, "seconds": round(seconds), **scores}))


def table(config: KeypointConfig, runs: Path) -> str:
    """Of the variants that have a result."""
    rows = [
        f"| {config.name} | steps | seconds | ADD, % | 5°5cm, % | rotation, median ° | translation, median mm "
        "| keypoint, median px |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for number in range(len(VARIANTS)):
        path = runs / f"{config.name}_ablation_{number}" / "result.json"
        if path.exists():
            r = json.loads(path.read_text())
            rows.append(
                f"| {r['name']} | {r['steps']} | {r['seconds']} | {r['add_percent']:.1f} | {r['deg5_cm5_percent']:.1f} "
                f"| {r['rotation_median_deg']:.1f} | {r['translation_median_mm']:.1f} | {r['keypoint_median_px']:.1f} |"
            )
    return "\n".join(rows) + "\n"
