"""`train.toml`: all settings of one object's training. Paths in it are relative to the folder given by `--data`."""

import tomllib
from dataclasses import dataclass, fields
from pathlib import Path


@dataclass(frozen=True)
class Config:
    name: str
    obj_id: int
    photoreal: str  # BOP split: half of every batch
    rasterised: str = ""  # BOP split of fast renders: the other half; may be left out
    validation: str = ""
    models: str = ""  # BOP models folder: for scores only
    backgrounds: str = ""  # folder of photos; without it nothing is pasted
    held_out_scenes: int = 6  # last scenes of `photoreal`, kept for calibrating the covariances
    min_visible: float = 0.35
    steps: int = 12500
    batch: int = 32
    learning_rate: float = 1.5e-3
    seed: int = 1


def load(path: Path) -> Config:
    values = tomllib.loads(path.read_text())
    unknown = set(values) - {field.name for field in fields(Config)}
    if unknown:
        raise ValueError(f"{path}: unknown setting {sorted(unknown)[0]!r}")
    return Config(**values)
