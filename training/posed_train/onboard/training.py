"""`posed-train train`: keypoint nets and a detector of one or more projects, without settings to write."""

import json
import multiprocessing
import os
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing.queues import SimpleQueue
from pathlib import Path

import torch

from .. import detector, export, quantize, scatter
from .. import train as training
from ..bop import DatasetError, View, read_json, read_views
from ..check import check
from ..config import DetectorConfig, KeypointConfig
from ..data import Views
from ..held_out import look
from ..network import design
from ..novel_views import dataset
from ..spread import in_words
from ..trust import store
from . import project as projects
from . import result as results
from .backgrounds import make_backgrounds
from .checking import MIN_VISIBLE, up
from .judged import judge, read_network
from .project import SPLIT, Item, Project
from .symmetry import motions
from .weak import advice

SCENES = ("camera", "gt", "gt_info")
NOVEL_VIEWS = "novel-views"
PER_PHOTO = 8
PHOTOREAL_SHARE = 0.4
"""Of every batch; the rest are novel views."""


@dataclass(frozen=True)
class Plan:
    """How long to train, and where the results go."""

    models: Path
    steps: int
    detector_steps: int
    workers: int
    network: str
    """Of the keypoint nets."""
    threads: int | None = None
    """Of each training; as many as there are cores for it, if `None`."""
    stops_itself: bool = True
    """Keypoint nets, once they learn no more."""


def train_projects(folders: Sequence[Path], plan: Plan, init: Path | None) -> None:
    design(plan.network)
    loaded = [projects.load(folder) for folder in folders]
    names = [item.name for project in loaded for item in project.items]
    if len(set(names)) < len(names):
        raise DatasetError(f"objects {', '.join(sorted(names))}: two of one name; rename one in its object.toml")
    work = [(project, item, ready(project, item)) for project in loaded for item in project.items]
    for project, item, views in work:
        find_backgrounds(project, item, views)
        make_novel_views(project, item, plan)
    train_all(work, plan, init)
    train_detector(work, plan)
    folders = " ".join(dict.fromkeys(str(project.folder) for project in loaded))
    where = "" if plan.models == Path("models") else f" --models {plan.models}"
    print(f"{plan.models}: {', '.join(names)} and a detector of them; next, `posed-train export {folders}{where}`")


def ready(project: Project, item: Item) -> list[View]:
    """Before anything is trained: the views, and what is wrong with them."""
    try:
        views = read_views(project.split, item.obj_id, MIN_VISIBLE)
    except DatasetError as error:
        raise DatasetError(f"{item.name}: {error}; `posed-train label {project.folder}` first") from None
    report = check(views, "camera", tuple(item.size_mm) or None, up(project))
    print(f"{item.name}: {report}")
    for problem in report.problems:
        print(f"warning: {item.name}: {problem}")
    return views


def train_all(work: list[tuple[Project, Item, list[View]]], plan: Plan, init: Path | None) -> None:
    """Side by side on a CPU: a step of one net keeps one core busy, and is hardly quicker on two."""
    cores = len(os.sched_getaffinity(0))
    together = 1 if torch.cuda.is_available() else min(len(work), cores)
    if together == 1:
        for project, item, views in work:
            train_keypoints(project, item, views, plan, init)
        return
    context = multiprocessing.get_context("spawn")
    lines = context.SimpleQueue()
    for line in range(together):
        lines.put(line)
    threads = plan.threads or max(1, cores // together)
    with ProcessPoolExecutor(together, context, begin_beside_others, (lines, threads)) as pool:
        trained = [pool.submit(train_keypoints, *one, plan, init) for one in work]
    for one in trained:
        one.result()


def begin_beside_others(lines: SimpleQueue, threads: int) -> None:
    """In a process of its own, whose progress has a line of its own."""
    training.progress_line = lines.get()
    training.use_threads(threads)


def find_backgrounds(project: Project, item: Item, views: list[View]) -> None:
    boxes = defaultdict(list)
    for other in project.items:
        for view in read_views(project.split, other.obj_id, min_box_px=1):
            boxes[view.image_path].append(view.box)
    count = make_backgrounds(views, boxes, project.folder / "backgrounds")
    print(f"{item.name}: {count} backgrounds")


def make_novel_views(project: Project, item: Item, plan: Plan) -> None:
    settings = replace(settings_of(project, item, plan), novel_views="")
    views = Views(settings, project.folder)
    settings = replace(settings, novel_views=f"{NOVEL_VIEWS}/{item.name}")
    try:
        count = dataset.make(views, settings, project.folder, PER_PHOTO)
    except DatasetError as error:
        print(f"warning: {item.name}: no novel views: {error}")
        return
    few = f"none, for want of {dataset.MIN_PHOTOS} photos of a scene that show all of it, with masks"
    print(f"{item.name}: novel views: {count or few}")


def settings_of(project: Project, item: Item, plan: Plan) -> KeypointConfig:
    folder = f"{NOVEL_VIEWS}/{item.name}"
    made = any((project.folder / folder / SPLIT).glob("*/made_of.json"))
    return KeypointConfig(
        name=item.name,
        obj_id=item.obj_id,
        photoreal=SPLIT,
        novel_views=folder if made else "",
        photoreal_share=PHOTOREAL_SHARE,
        poses="camera",
        backgrounds="backgrounds",
        network=plan.network,
        symmetries_discrete=motions(item.symmetries),
        steps=plan.steps,
        stops_itself=plan.stops_itself,
    )


def train_keypoints(project: Project, item: Item, views: list[View], plan: Plan, init: Path | None) -> None:
    settings = settings_of(project, item, plan)
    out, before = run_folders(project, item, views)
    init = init or before
    net, placed, _, step, last = training.train(settings, project.folder, out, init, plan.workers)
    told = look(training.predictor(net, placed.heights), placed)
    spread = {"photos": 0, "agreeing": 0} if told is None else told.spread
    summary = {"network": settings.network, "steps": last, "best_step": step, "views": len(views)}
    summary |= {"relative_poses": "camera", "held_out": spread}
    identity = {"name": item.name, "obj_id": item.obj_id}
    model = plan.models / item.name
    export.export_keypoints(net.cpu(), placed, model, identity, summary, settings.symmetries_discrete)
    print(quantize.quantize_keypoints(model, [placed.all[index] for index in placed.registration.placed]))
    results.write(out, export.sha256(model / "keypoints.onnx"), settings.network, last, step, placed)
    state_covariances(model, placed)
    print("\n".join([f"{item.name}: {in_words(spread)}", *(f"  - {one}" for one in weaknesses(project, item, plan))]))


def state_covariances(model: Path, placed: Views) -> None:
    """In `object.json`, if the held-out photos can tell: by what the service is to widen them."""
    network = read_network(model)
    found = scatter.covariance_trust(export.predictor(model / "keypoints.onnx", network.heights), placed, network.scale)
    if found is not None:
        store(model / "object.json", found)


def weaknesses(project: Project, item: Item, plan: Plan) -> list[str]:
    return advice(judge(project, item, plan.models))


def run_folders(project: Project, item: Item, views: list[View]) -> tuple[Path, Path | None]:
    """One for each number of scenes; and the checkpoint of the training before scenes were added, to go on from."""
    scenes = len({view.scene for view in views})
    folders = [project.folder / "runs" / (item.name if k == 1 else f"{item.name}-{k}") for k in range(1, scenes + 1)]
    trained = [folder / "checkpoint.pt" for folder in folders[:-1] if (folder / "checkpoint.pt").exists()]
    return folders[-1], trained[-1] if trained else None


def train_detector(work: list[tuple[Project, Item, list[View]]], plan: Plan) -> None:
    """Of all objects together, from one folder in which each has a number of its own."""
    root = plan.models / ".detector"
    labels = [item.name for _, item, _ in work]
    gather([(project, item.obj_id, number) for number, (project, item, _) in enumerate(work, 1)], root / SPLIT)
    (root / "backgrounds").mkdir(exist_ok=True)
    for project in {project.folder: project for project, _, _ in work}.values():
        for path in (project.folder / "backgrounds").glob("*.jpg"):
            link(path, root / "backgrounds" / f"{project.folder.resolve().name}-{path.name}")
    settings = DetectorConfig(
        labels=labels,
        obj_ids=list(range(1, len(labels) + 1)),
        photoreal=SPLIT,
        rasterised="",
        validation="",
        backgrounds="backgrounds",
        steps=plan.detector_steps,
    )
    model = detector.train(settings, root, root / f"run-{'-'.join(labels)}")
    summary = {"network": settings.network, "steps": settings.steps, "validation": {}}
    folder = plan.models / "detector"
    export.export_detector(model.cpu(), labels, folder, summary, settings.score_threshold)
    print(quantize.quantize_detector(folder, sorted((root / SPLIT).glob("*/rgb/*"))))


def gather(wanted: list[tuple[Project, int, int]], out: Path) -> None:
    """Links the scenes of several projects into one split; `wanted` says which object gets which number."""
    new_ids: dict[Path, dict[int, int]] = defaultdict(dict)
    for project, old, new in wanted:
        new_ids[project.folder][old] = new
    number = 0
    for project in {project.folder: project for project, _, _ in wanted}.values():
        for scene in project.scenes:
            folder = out / f"{number:06d}"
            folder.mkdir(parents=True, exist_ok=True)
            for sub in ("rgb", "mask_visib"):
                if (scene / sub).is_dir():
                    link(scene / sub, folder / sub)
            for name in SCENES:
                content = read_json(scene / f"scene_{name}.json")
                if name == "gt":
                    content = {
                        key: [renumbered(one, new_ids[project.folder]) for one in row] for key, row in content.items()
                    }
                (folder / f"scene_{name}.json").write_text(json.dumps(content))
            number += 1


def renumbered(entry: dict, new_ids: dict[int, int]) -> dict:
    """An object that is not wanted gets a number that no object has; its place in the list stays."""
    return entry | {"obj_id": new_ids.get(entry["obj_id"], 0)}


def link(target: Path, path: Path) -> None:
    if path.is_symlink():
        path.unlink()
    os.symlink(target.resolve(), path)
