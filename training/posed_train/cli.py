"""Trains the networks that posed serves, from images with known relative camera poses."""

import argparse
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from . import corrupt
from .bop import DatasetError
from .onboard import command as onboarding
from .render import command as rendering


def lazily(name: str) -> Callable[[argparse.Namespace], None]:
    """A function of `commands`, which is imported when it is called: PyTorch takes seconds."""

    def run(arguments: argparse.Namespace) -> None:
        from . import commands

        getattr(commands, name)(arguments)

    return run


def main() -> None:
    parser = argparse.ArgumentParser(prog="posed-train", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    onboarding.add_commands(commands)

    render = commands.add_parser("render", help="render random scenes of coloured meshes into a BOP-format folder")
    rendering.add_arguments(render)
    render.set_defaults(run=lazily("run_render"))

    checking = commands.add_parser("check", help="tell whether a dataset can teach a keypoint net, before training")
    onboarding.add_check(checking)
    checking.set_defaults(run=run_check)

    making = commands.add_parser(
        "novel-views", help="render an object's photos from beside, in other light, to learn from"
    )
    making.add_argument("settings", type=Path, help="train.toml; its `novel_views` names the folder")
    making.add_argument("--data", type=Path, required=True, help="folder that the paths in train.toml start from")
    making.add_argument("--per-photo", type=int, default=10)
    making.set_defaults(run=lazily("run_novel_views"))

    packing = commands.add_parser("pack", help="copy what a keypoint net's training needs of a dataset, as small crops")
    packing.add_argument("settings", type=Path, help="train.toml")
    packing.add_argument("out", type=Path, help="new folder, to be given as --data")
    packing.add_argument("--data", type=Path, required=True, help="folder that the paths in train.toml start from")
    packing.set_defaults(run=lazily("run_pack"))

    cutting = commands.add_parser("cut-off", help="make half-hidden views for `posed evaluate` of a split's whole ones")
    cutting.add_argument("split", type=Path, help="folder of scenes, with masks")
    cutting.add_argument("out", type=Path, help="new folder")
    cutting.add_argument("--objects", type=int, nargs="+", required=True, help="by their obj_id")
    cutting.set_defaults(run=lazily("run_cut_off"))

    troubling = commands.add_parser("corrupt", help="copy a split with one kind of trouble, for `posed evaluate`")
    troubling.add_argument("split", type=Path, help="folder of scenes")
    troubling.add_argument("out", type=Path, help="new folder")
    troubling.add_argument("--trouble", choices=corrupt.TROUBLES, required=True)
    troubling.add_argument("--strength", type=int, choices=range(1, corrupt.STRENGTHS + 1), required=True)
    troubling.add_argument("--scenes", type=int, help="only so many scenes, the last")
    troubling.set_defaults(run=lazily("run_corrupt"))

    trusting = commands.add_parser("trust", help="fit covariances that hold and probabilities, and store them")
    trusting.add_argument("objects", nargs="+", help="names of model folders")
    trusting.add_argument(
        "--split", type=Path, action="append", required=True, help="views that no net has learned from"
    )
    trusting.add_argument(
        "--also", type=Path, action="append", default=[], help="more of them, with some trouble: not for the threshold"
    )
    trusting.add_argument("--meshes", type=Path, required=True, help="folder with models_info.json")
    trusting.add_argument("--models", type=Path, default=Path("models"))
    trusting.add_argument("--reference", type=Path, default=Path("reference"))
    trusting.add_argument("--posed", type=Path, default=Path("target/release/posed"), help="the program")
    trusting.add_argument("--lines", type=Path, help="keep what it said of each view here, or take it from here")
    trusting.set_defaults(run=lazily("run_trust"))

    keypoints = commands.add_parser("keypoints", help="train one object's keypoint net and export it")
    detect = commands.add_parser("detector", help="train the detector of all objects and export it")
    for command in (keypoints, detect):
        command.add_argument("settings", type=Path, help="train.toml")
        command.add_argument("--data", type=Path, required=True, help="folder that the paths in train.toml start from")
        command.add_argument("--runs", type=Path, default=Path("runs"), help="checkpoints and logs; resumed from")
        command.add_argument("--models", type=Path, default=Path("models"), help="where the export goes")
        command.add_argument("--init", type=Path, help="keypoint net to start from: checkpoint.pt, or keypoints.onnx")
        command.add_argument("--threads", type=int)
    ablating = commands.add_parser("ablate", help="train one object's net in several ways and print a table")
    ablating.add_argument("settings", type=Path, help="train.toml")
    ablating.add_argument("--data", type=Path, required=True, help="folder that the paths in train.toml start from")
    ablating.add_argument("--runs", type=Path, default=Path("runs"))
    ablating.add_argument("--only", type=int, nargs="*", help="some of the variants")
    ablating.add_argument("--threads", type=int)
    ablating.set_defaults(run=lazily("run_ablate"))
    keypoints.add_argument("--workers", type=int, default=0, help="processes that prepare batches; a GPU needs several")
    keypoints.set_defaults(run=lazily("run_keypoints"))
    detect.set_defaults(run=lazily("run_detector"))

    quantizing = commands.add_parser("quantize", help="copy an exported network to compute in 8 bits, and compare")
    quantizing.add_argument("model", type=Path, help="model folder, of an object or of the detector")
    quantizing.add_argument("out", type=Path, help="new model folder")
    quantizing.add_argument("--split", type=Path, required=True, help="BOP split that it learned from")
    quantizing.set_defaults(run=lazily("run_quantize"))

    arguments = parser.parse_args()
    if threading.current_thread() is threading.main_thread():
        # As Ctrl-C: what is half-written is removed.
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        arguments.run(arguments)
    except (DatasetError, ValueError, FloatingPointError, OSError) as error:
        sys.exit(f"posed-train: {error}")
    except RecursionError:
        sys.exit("posed-train: a file that was given is nested too deeply to be read")
    except KeyboardInterrupt:
        sys.exit(130)


def run_check(arguments: argparse.Namespace) -> None:
    if arguments.settings.suffix == ".toml":
        lazily("run_check")(arguments)
    else:
        onboarding.run_check(arguments)
