"""`result.json` beside a training: what is needed to say later how good its net is."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..bop import DatasetError, read_json
from ..data import Views
from ..joined import write_json
from .project import Item, Project

FILE = "result.json"


@dataclass(frozen=True)
class Result:
    model_sha256: str
    network: str
    steps: int  # that it was trained for
    best_step: int  # that the net is of
    held_out: list[list]
    """Scene and image of each photo that the net has not learned from."""
    keypoints_from_object: list[list[float]] | None
    """`[4, 4]`: where the frame of the object's box lies, if its first scene was placed."""

    def is_held_out(self, scene: str, image_id: int) -> bool:
        return [scene, image_id] in self.held_out


def write(out: Path, model_sha256: str, network: str, steps: int, best_step: int, views: Views) -> None:
    known = views.keypoints_from_object
    held_out = [[views.all[k].scene, views.all[k].image_id] for k in views.held_out]
    result = Result(model_sha256, network, steps, best_step, held_out, None if known is None else known.tolist())
    write_json(out / FILE, asdict(result))


def find(project: Project, item: Item, model_sha256: str, models: Path) -> tuple[Result, Path]:
    """Of the training that made a network, and its folder."""
    for folder in sorted((project.folder / "runs").glob(f"{item.name}*")):
        if (folder / FILE).exists():
            result = Result(**read_json(folder / FILE))
            if result.model_sha256 == model_sha256:
                return result, folder
    raise DatasetError(
        f"{models / item.name}: not a network that `posed-train train {project.folder}` made as the project is now; "
        "train it, or say with --models where its network is"
    )


def offset(result: Result) -> np.ndarray | None:
    """`object_from_keypoints` as the training placed them."""
    return None if result.keypoints_from_object is None else np.linalg.inv(np.array(result.keypoints_from_object))
