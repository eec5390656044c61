"""What the commands of `posed-train` do that train or render."""

import argparse
import importlib.util
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from . import ablate, check, config, corrupt, cut_off, data, detector, export, pack, quantize, train, trust
from .novel_views import dataset
from .onboard.checking import conclude
from .render import command as rendering
from .size import parse_size

BLENDER_PYTHON = Path(__file__).parents[1] / ".venv-blender/bin/python"


def run_render(arguments: argparse.Namespace) -> None:
    if arguments.engine == "cycles" and importlib.util.find_spec("bpy") is None:
        # Blender has an environment of its own: it wants an older numpy than PyTorch's friends do.
        if not BLENDER_PYTHON.exists():
            raise OSError(f"{BLENDER_PYTHON} is missing: `make render-env` installs Blender there")
        sys.exit(subprocess.run([BLENDER_PYTHON, "-m", "posed_train.render.command", *sys.argv[2:]]).returncode)
    rendering.run(arguments)


def run_check(arguments: argparse.Namespace) -> None:
    settings = config.load(arguments.settings, config.KeypointConfig)
    if arguments.data is None:
        raise ValueError("--data: give the folder that the paths in train.toml start from")
    size_mm = parse_size(arguments.size_mm) if arguments.size_mm else None
    report = check.check(data.read_photoreal(settings, arguments.data), settings.poses, size_mm)
    print(report)
    if settings.backgrounds:
        size = data.design(settings.network).input_size
        print(f"backgrounds: {len(data.read_backgrounds(arguments.data / settings.backgrounds, size))}")
    conclude(report.problems)


def run_novel_views(arguments: argparse.Namespace) -> None:
    settings = config.load(arguments.settings, config.KeypointConfig)
    if not settings.novel_views:
        raise ValueError(f"{arguments.settings}: set novel_views to the folder that they shall be in")
    views = data.Views(replace(settings, novel_views=""), arguments.data)
    made = dataset.make(views, settings, arguments.data, arguments.per_photo)
    if not made:
        raise ValueError(
            f"no scene has {dataset.MIN_PHOTOS} photos that show all of the object, have masks, and are not held out"
        )
    print(f"{arguments.data / settings.novel_views}: {made} views")


def run_pack(arguments: argparse.Namespace) -> None:
    settings = config.load(arguments.settings, config.KeypointConfig)
    written = pack.pack(settings, arguments.data, arguments.out)
    print(f"{arguments.out}: {written / 1e6:.1f} MB")


def run_cut_off(arguments: argparse.Namespace) -> None:
    print(f"{arguments.out}: {cut_off.cut_off(arguments.split, arguments.out, arguments.objects)} views")


def run_corrupt(arguments: argparse.Namespace) -> None:
    trouble, strength = arguments.trouble, arguments.strength
    count = corrupt.corrupt(arguments.split, arguments.out, trouble, strength, arguments.scenes)
    print(f"{arguments.out}: {count} images")


def run_trust(arguments: argparse.Namespace) -> None:
    def evaluated() -> list[dict]:
        splits, meshes = arguments.split + arguments.also, arguments.meshes
        return trust.evaluate(arguments.posed, arguments.models, arguments.reference, arguments.objects, splits, meshes)

    lines = [line for line in trust.lines(arguments.lines, evaluated) if line["object"] in arguments.objects]
    lines = trust.usable(lines)
    common = np.isin([line["split"] for line in lines], [str(split) for split in arguments.split])
    by_object, figures = trust.fit_trust(trust.collect(lines), common)
    for name, found in by_object.items():
        trust.store(arguments.models / name / "object.json", found)
    print(figures)


def run_ablate(arguments: argparse.Namespace) -> None:
    train.use_threads(arguments.threads)
    settings = config.load(arguments.settings, config.KeypointConfig)
    ablate.run(
        settings,
        arguments.data,
        arguments.runs,
        list(range(len(ablate.VARIANTS)) if arguments.only is None else arguments.only),
    )
    print(ablate.table(settings, arguments.runs))


def run_keypoints(arguments: argparse.Namespace) -> None:
    train.use_threads(arguments.threads)
    settings = config.load(arguments.settings, config.KeypointConfig)
    report = check.check(data.read_photoreal(settings, arguments.data), settings.poses)
    print("\n".join([str(report), *(f"warning: {problem}" for problem in report.problems)]))
    net, views, scores, step, last = train.train(
        settings, arguments.data, arguments.runs / settings.name, arguments.init, arguments.workers
    )
    summary = {
        "network": settings.network,
        "steps": last,
        "best_step": step,
        "views": len(views.all),
        "relative_poses": settings.poses,
        "validation": {key: round(value, 2) for key, value in scores.items()},
    }
    identity = {"name": settings.name, "obj_id": settings.obj_id}
    out = arguments.models / settings.name
    export.export_keypoints(net.cpu(), views, out, identity, summary, settings.symmetries_discrete)
    print(f"{out}: {summary}")
    print(quantize.quantize_keypoints(out, [views.all[index] for index in views.registration.placed]))


def run_quantize(arguments: argparse.Namespace) -> None:
    print(quantize.quantize(arguments.model, arguments.out, arguments.split))


def run_detector(arguments: argparse.Namespace) -> None:
    train.use_threads(arguments.threads)
    settings = config.load(arguments.settings, config.DetectorConfig)
    model = detector.train(settings, arguments.data, arguments.runs / "detector", arguments.init)
    scores = {}
    if settings.validation:
        scores = detector.recall(model, detector.read_samples(arguments.data / settings.validation, settings.obj_ids))
    summary = {"network": settings.network, "steps": settings.steps}
    summary["validation"] = {key: round(value, 3) for key, value in scores.items()}
    out = arguments.models / "detector"
    export.export_detector(model.cpu(), settings.labels, out, summary, settings.score_threshold)
    print(f"{out}: {summary}")
    splits = [settings.photoreal] if isinstance(settings.photoreal, str) else settings.photoreal
    images = [path for split in splits for path in sorted((arguments.data / split).glob("*/rgb/*"))]
    print(quantize.quantize_detector(out, images))
