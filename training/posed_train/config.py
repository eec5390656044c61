"""`train.toml`: all settings of one training. Paths in it are relative to the folder given by `--data`."""

import math
import tomllib
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import TypeVar


@dataclass(frozen=True)
class KeypointConfig:
    """A keypoint net for one object."""

    name: str
    obj_id: int
    photoreal: str | list[str]  # BOP splits
    rasterised: str | list[str] = ""  # BOP splits of fast renders; may be left out
    novel_views: str = ""  # what `posed-train novel-views` makes of `photoreal`; may be left out
    validation: str = ""
    models: str = ""  # BOP models folder: for scores only
    backgrounds: str = ""  # folder of photos; without it nothing is pasted
    poses: str = "object"  # where relative poses come from: `object` poses, or the `camera` poses of still scenes
    masks: bool = True  # use them where there are any, to paste the object on other backgrounds
    network: str = "lite0"  # starts from ImageNet, as `lite0-224` does; or `lite` or `paper`, from nothing
    keypoint_shape: str = "cube"
    keypoint_count: int = 8  # of the random shapes
    symmetries_discrete: list[list[float]] = field(default_factory=list)  # of the object, as in BOP's models_info.json
    up: list[float] = field(default_factory=list)  # of the object's frame: points up in second looks; of a symmetric
    # object best an axis of symmetry. Without it, the z axis of the keypoints' frame.
    front: list[float] = field(default_factory=list)  # of the object's frame, square to `up`: of the ways to see a
    # symmetric object, learn the one with this axis towards the camera and `up` upwards, not any.
    loss: str = "component"  # `pairwise` and `registration`: the paper's losses, the latter without consistency
    held_out_scenes: int = 6  # last scenes of `photoreal`, kept for calibrating the covariances
    held_out_every: int = 8  # where there are too few scenes: every so manieth view instead
    min_visible: float = 0.35
    steps: int = 12500
    stops_itself: bool = False  # ends sooner where held-out views no longer gain from more steps, see stopping.py
    batch: int = 32
    photoreal_share: float = 0.5  # of every batch, if there are rasterised or novel views
    learning_rate: float = 1.5e-3
    distance_weight: float = 0.05  # of the keypoints' distance (px) beside the cross-entropy, once they are about right
    scale_weight: float = 0.0  # of their common scale's error (px), then, too: depth hangs on it
    encoder_rate: float = 0.2  # of the learning rate, for an encoder that starts from ImageNet
    frozen: list[str] = field(default_factory=list)  # parts of the network, as "encoder.stages.3", whose convolutions
    # stay those that training starts from; their normalisation still learns.
    frozen_statistics: bool = False  # the encoder normalises by the statistics that it starts with, and frozen parts
    # are held as a whole, which makes a step faster where they are the first ones
    augmentation: float = 1.0  # strength for the first half; it falls by 80 % of the steps...
    final_augmentation: float = 0.4  # ... to so much of this: 1 where images to come are of other places
    pasted_share: float = 0.5  # of the crops: the object before another background, at full strength
    seed: int = 1

    def __post_init__(self) -> None:
        if not 0 < self.photoreal_share <= 1:
            raise ValueError(f"photoreal_share {self.photoreal_share}: must be above 0 and at most 1")
        for name in ("final_augmentation", "pasted_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} {getattr(self, name)}: must be from 0 to 1")
        if not 0 <= self.encoder_rate <= 1:
            raise ValueError(f"encoder_rate {self.encoder_rate}: must be from 0 to 1, a share of learning_rate")
        for name, axis in (("up", self.up), ("front", self.front)):
            if axis and not (len(axis) == 3 and abs(math.hypot(*axis) - 1) < 0.01):
                raise ValueError(f"{name} {axis}: must be a direction of length 1, as [0, 0, 1]")
        if self.front and not (self.up and abs(sum(u * f for u, f in zip(self.up, self.front))) < 0.01):
            raise ValueError(f"front {self.front}: must be at right angles to `up`, which is {self.up or 'not given'}")


@dataclass(frozen=True)
class DetectorConfig:
    """One detector for all objects."""

    labels: list[str]
    obj_ids: list[int]
    photoreal: str | list[str]  # half of every batch
    rasterised: str | list[str]
    validation: str
    backgrounds: str = ""
    network: str = "lite0"  # whose encoder it has: `lite0`, from ImageNet, or `lite`, from nothing
    steps: int = 3000
    batch: int = 8
    learning_rate: float = 1e-3
    score_threshold: float = 0.4
    seed: int = 1


def splits(setting: str | list[str]) -> list[str]:
    """The BOP splits of a setting: one, several, or none ("")."""
    return [setting] if setting and isinstance(setting, str) else list(setting)


Config = TypeVar("Config", KeypointConfig, DetectorConfig)


def load(path: Path, kind: type[Config]) -> Config:
    values = tomllib.loads(path.read_text())
    unknown = set(values) - {field.name for field in fields(kind)}
    if unknown:
        raise ValueError(f"{path}: unknown setting {sorted(unknown)[0]!r}")
    missing = {f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING} - set(values)
    if missing:
        raise ValueError(f"{path}: setting {sorted(missing)[0]!r} is missing")
    return kind(**values)
