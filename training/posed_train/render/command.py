"""`posed-train render`, and `python -m posed_train.render.command`, which does without PyTorch."""

import argparse
import sys
from pathlib import Path

from .dataset import FILMS, render_dataset
from .objects import choose_objects, load_objects


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("models", type=Path, help="BOP models folder: obj_NNNNNN.ply in mm, coloured vertices")
    parser.add_argument("out", type=Path)
    parser.add_argument("--engine", choices=("rasteriser", "cycles"), default="rasteriser")
    parser.add_argument("--scenes", type=int, default=520)
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--first", type=int, default=0, help="number of the first scene, to split work over processes")
    parser.add_argument("--objects", type=int, nargs="+", help="only these, by their obj_id")
    parser.add_argument("--copies", type=int, default=1, help="of each object in every scene")
    parser.add_argument(
        "--camouflage", type=float, default=0.0, help="share of things around the objects in a colour of one of them"
    )
    parser.add_argument(
        "--film",
        choices=FILMS,
        help="the views are those of a camera that goes past, thirty a second; moving: the first object moves",
    )


def run(arguments: argparse.Namespace) -> None:
    # Each engine needs what the other, and training, do not: EGL for MuJoCo, Blender for Cycles.
    if arguments.engine == "cycles":
        from .cycles import Cycles as engine
    else:
        from .rasteriser import Rasteriser as engine
    render_dataset(
        engine,
        choose_objects(load_objects(arguments.models), arguments.objects, arguments.copies),
        arguments.out,
        arguments.scenes,
        arguments.views,
        arguments.first,
        arguments.camouflage,
        arguments.film,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="render", description=__doc__)
    add_arguments(parser)
    try:
        run(parser.parse_args())
    except (ValueError, OSError) as error:
        sys.exit(f"posed-train: {error}")
