"""What posed itself says of held-out photos: `posed evaluate --without-truth`."""

import json
import os
import subprocess
import tempfile
from collections import defaultdict
from pathlib import Path

from ..bop import DatasetError, image_path, read_json
from .judged import Judgement

PATIENCE_S = 1800


def evaluate(posed: Path, models: Path, reference: dict, found: Judgement, name: str) -> dict:
    """Its report of the object (`objects[0]`), by the whole pipeline with the detector, on held-out photos alone."""
    with tempfile.TemporaryDirectory(prefix="posed-report-") as scratch:
        folder = Path(scratch)
        (folder / "reference").mkdir()
        (folder / "reference" / f"{name}.json").write_text(json.dumps(reference))
        gather(found, folder / "split")
        out = folder / "report.json"
        words = ["evaluate", name, "--split", folder / "split", "--without-truth", "--json", out]
        words += ["--models", models, "--reference", folder / "reference"]
        try:
            done = subprocess.run(
                [posed, *map(str, words)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
            )
        except OSError as error:
            raise DatasetError(f"--posed {posed}: {error.strerror}") from None
        except subprocess.TimeoutExpired:
            raise DatasetError(f"--posed {posed}: no answer after {PATIENCE_S} s") from None
        # It also fails where no two poses can be compared; what it wrote says so.
        if not out.exists():
            raise DatasetError(f"--posed {posed}: evaluate failed: {done.stderr.strip()[-2000:]}")
        return json.loads(out.read_text())["objects"][0]


def gather(found: Judgement, split: Path) -> None:
    """The held-out photos with their camera poses, as a split."""
    by_scene = defaultdict(list)
    for one in found.held_out:
        by_scene[one.view.scene].append(one.view)
    for scene, views in by_scene.items():
        source, folder = Path(views[0].split) / scene, split / scene
        (folder / "rgb").mkdir(parents=True)
        cameras = read_json(source / "scene_camera.json")
        chosen = {str(view.image_id): cameras[str(view.image_id)] for view in views}
        (folder / "scene_camera.json").write_text(json.dumps(chosen))
        for view in views:
            path = image_path(source, view.image_id)
            os.symlink(path.resolve(), folder / "rgb" / path.name)
