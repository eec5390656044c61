"""The commands that take a project folder: their options, and what they call."""

import argparse
from collections.abc import Callable
from pathlib import Path

from . import printing
from .from_board import BoardOptions
from .photos import DEFAULT_MAX_PX
from .tags import DEFAULT_FAMILY, FAMILIES


def add_commands(commands) -> None:
    add_board(commands.add_parser("board", help="write a board of tags to print and put the object on"))
    add_new(commands.add_parser("new", help="make a project of photos of an object on a board of tags"))
    add_add(commands.add_parser("add", help="more photos of a project's objects: another room, or another side down"))
    add_train(commands.add_parser("train", help="train keypoint nets and a detector for one or more projects"))
    add_export(commands.add_parser("export", help="write each object's bundle, for `posed objects add`, and a report"))
    add_label(commands.add_parser("label", help="boxes and masks in all photos, by a 3D box placed in a page"))


def add_board(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("out", type=Path, nargs="?", default=Path("board.pdf"), help=".pdf or .svg (board.pdf)")
    parser.add_argument("--paper", choices=list(printing.PAPERS), default="a4")
    parser.add_argument("--tag-mm", type=positive, help="side of a tag's black square (fitted to the paper)")
    parser.add_argument("--family", choices=list(FAMILIES), default=DEFAULT_FAMILY)
    parser.add_argument("--first", type=int, default=0, help="number of the first tag: another one for a second board")
    parser.add_argument("--charuco", action="store_true", help="a ChArUco board, without a free middle")
    parser.add_argument(
        "--legacy", action="store_true", help="the ChArUco pattern of calib.io and of OpenCV before 4.6"
    )
    parser.set_defaults(run=run_board)


def run_board(arguments: argparse.Namespace) -> None:
    if arguments.charuco:
        sheet = printing.charuco_board(arguments.paper, arguments.legacy, arguments.first)
    else:
        sheet = printing.tag_board(arguments.paper, arguments.tag_mm, arguments.first, arguments.family)
    printing.write_sheet(sheet, arguments.out)
    print(
        f"{arguments.out}: {sheet.tags} tags on {arguments.paper}. Print it at 100 % (not fitted to the page), glue it "
        "to something flat, measure the side of a tag's black square, and give it as --tag-mm"
    )


def add_new(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("project", type=Path, help="new folder, named as the object")
    parser.add_argument("source", type=Path, nargs="?", help="folder of photos, or a video")
    parser.add_argument("--objects", nargs="+", default=[], help="names, if there are several")
    poses = parser.add_mutually_exclusive_group()
    poses.add_argument("--transforms", type=Path, help="transforms.json of nerfstudio or instant-ngp")
    poses.add_argument("--colmap", type=Path, help="folder of a COLMAP model, text or binary")
    poses.add_argument("--poses", type=Path, help="rows: image x y z qx qy qz qw (or rx ry rz) of a robot's flange")
    poses.add_argument("--bop", type=Path, help="BOP split or scene with camera poses")
    poses.add_argument("--pairs", type=Path, help="stereo pairs with their relative poses")
    parser.add_argument("--apart", action="store_true", help="do not join --pairs by what their photos share")
    parser.add_argument("--unit-mm", type=positive, help="of the poses' translations: 1000 for metres")
    parser.add_argument("--distance", type=Path, help="two points clicked in two photos each, and their distance")
    parser.add_argument("--flange-from-camera", help="x y z qx qy qz qw, in the unit of --poses; else by the tags")
    add_board_options(parser)
    parser.set_defaults(run=run_new)


def add_board_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--tag-mm", type=positive, help="measured side of a tag's black square")
    parser.add_argument(
        "--span-mm", nargs=3, type=float, metavar=("A", "B", "MM"), help="measured from the middle of tag A to tag B's"
    )
    parser.add_argument("--camera", type=Path, help="camera file; without it the photos tell the camera")
    parser.add_argument("--family", choices=list(FAMILIES), default=DEFAULT_FAMILY)
    parser.add_argument(
        "--max-px", type=whole(200), default=DEFAULT_MAX_PX, help="longer side; larger photos are made smaller"
    )
    parser.add_argument("--frames", type=whole(8), default=150, help="to take from a video")
    parser.add_argument("--from", dest="first", metavar="PHOTO", help="first photo to take, in the order of names")
    parser.add_argument("--to", dest="last", metavar="PHOTO", help="last photo to take")
    parser.add_argument("--without", nargs="+", default=[], metavar="PHOTO", help="photos to leave out, by their names")


def board_options(arguments: argparse.Namespace) -> BoardOptions:
    if arguments.tag_mm is None:
        raise ValueError("--tag-mm: measure the side of a tag's black square on the print and give it")
    return BoardOptions(
        tag_mm=arguments.tag_mm,
        span_mm=tuple(arguments.span_mm) if arguments.span_mm else None,
        camera=arguments.camera,
        family=arguments.family,
        max_px=arguments.max_px,
        frames=arguments.frames,
        without=tuple(arguments.without),
        first=arguments.first,
        last=arguments.last,
    )


def run_new(arguments: argparse.Namespace) -> None:
    from . import new
    from .importing import import_posed

    project, names = arguments.project, arguments.objects
    if arguments.apart and not arguments.pairs:
        raise ValueError("--apart: is for --pairs")
    if arguments.bop:
        print(new.new_from_bop(project, names, arguments.bop))
    elif arguments.transforms or arguments.colmap or arguments.poses or arguments.pairs:
        imported, source = import_posed(arguments)
        print(new.new_from_poses(project, names, imported, source))
    elif arguments.source is None:
        raise ValueError(
            "give a folder of photos or a video, or poses by --transforms, --colmap, --poses, --bop, --pairs"
        )
    else:
        print(new.new_from_board(project, names, arguments.source, board_options(arguments)))
    print(f"{project}: next, `posed-train label {project}`")


def add_add(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("project", type=Path, help="project folder")
    parser.add_argument("source", type=Path, help="folder of photos, or a video")
    add_board_options(parser)
    parser.set_defaults(run=run_add)


def run_add(arguments: argparse.Namespace) -> None:
    from .new import add_from_board

    scene, text = add_from_board(arguments.project, arguments.source, board_options(arguments))
    print(text)
    print(
        f"{arguments.project}: scene {scene} added. Draw boxes in three of its photos, `posed-train label`, then "
        "`posed-train train` goes on from the net that exists"
    )


def add_label(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("project", type=Path, help="project folder")
    labels = parser.add_mutually_exclusive_group()
    labels.add_argument("--box", type=Path, help="JSON file of drawn boxes")
    labels.add_argument("--coco", type=Path, help="COCO file of boxes, outlines or masks")
    labels.add_argument("--labelme", type=Path, help="folder of labelme's JSON files")
    labels.add_argument("--yolo", type=Path, help="folder of YOLO's text files, with classes.txt or data.yaml")
    labels.add_argument("--masks", type=Path, help="folder of PNG masks, or of one for each object")
    parser.add_argument(
        "--category", action="append", default=[], metavar="THEIRS=OURS", help="what a file calls an object"
    )
    parser.add_argument("--port", type=int, default=0, help="of the page, which is there if no labels are given (any)")
    parser.set_defaults(run=run_label)


def run_label(arguments: argparse.Namespace) -> None:
    if not (arguments.box or arguments.coco or arguments.labelme or arguments.yolo or arguments.masks):
        from .page_server import serve

        serve(arguments.project, arguments.port)
        return
    if arguments.box:
        from .label import label

        print(label(arguments.project, arguments.box))
    else:
        from .existing import import_labels

        print(import_labels(arguments.project, read_labels(arguments), categories(arguments.category)))
    print(f"{arguments.project}: look at pictures/labels-*.jpg; next, `posed-train check {arguments.project}`")


def read_labels(arguments: argparse.Namespace) -> list:
    from . import project
    from .from_coco import read_coco
    from .from_labelme import read_labelme
    from .from_masks import read_masks
    from .from_yolo import read_yolo

    if arguments.coco:
        return read_coco(arguments.coco)
    if arguments.labelme:
        return read_labelme(arguments.labelme)
    if arguments.yolo:
        return read_yolo(arguments.yolo)
    return read_masks(arguments.masks, [item.name for item in project.load(arguments.project).items])


def categories(told: list[str]) -> dict[str, str]:
    for text in told:
        if "=" not in text:
            raise ValueError(f"--category {text}: write what the file calls it, =, and the project's name for it")
    return dict(text.rsplit("=", 1) for text in told)


def add_check(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("settings", type=Path, help="project folder, or train.toml")
    parser.add_argument("--data", type=Path, help="folder that the paths in train.toml start from")
    parser.add_argument("--object", help="of the project; all, if none is given")
    parser.add_argument("--size-mm", help="length x width x height by a ruler, as 54x54x120")


def run_check(arguments: argparse.Namespace) -> None:
    from .checking import check_project

    check_project(arguments.settings, arguments.object, arguments.size_mm)


def add_train(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("projects", type=Path, nargs="+", help="project folders; their objects share a detector")
    parser.add_argument("--models", type=Path, default=Path("models"), help="where the export goes")
    parser.add_argument("--steps", type=whole(1), default=6000, help="of each keypoint net, at most")
    parser.add_argument("--to-the-end", action="store_true", help="all --steps, whether or not held-out photos gain")
    parser.add_argument("--detector-steps", type=whole(1), default=600)
    parser.add_argument("--network", default="lite0", help="of each keypoint net: lite0, lite, lite0-224 or paper")
    parser.add_argument("--init", type=Path, help="checkpoint of a keypoint net to start from")
    parser.add_argument(
        "--workers", type=whole(0), default=0, help="processes that prepare batches; a GPU needs several"
    )
    parser.add_argument(
        "--threads", type=whole(1), help="of each training; several objects are trained side by side on a CPU"
    )
    parser.set_defaults(run=run_train)


def run_train(arguments: argparse.Namespace) -> None:
    from ..train import use_threads
    from .training import Plan, train_projects

    use_threads(arguments.threads)
    plan = Plan(
        models=arguments.models,
        steps=arguments.steps,
        detector_steps=arguments.detector_steps,
        workers=arguments.workers,
        network=arguments.network,
        threads=arguments.threads,
        stops_itself=not arguments.to_the_end,
    )
    train_projects(arguments.projects, plan, arguments.init)


def add_export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("project", type=Path, help="project folder")
    parser.add_argument("--object", help="of the project; all, if none is given")
    parser.add_argument("--models", type=Path, default=Path("models"), help="where `train` put the networks")
    parser.add_argument("--out", type=Path, default=Path(), help="folder of the bundles (here)")
    parser.add_argument("--posed", type=Path, help="the program: its figures go into the report, too")
    parser.add_argument("--without-detector", action="store_true", help="the server's own knows the object")
    parser.set_defaults(run=run_export)


def run_export(arguments: argparse.Namespace) -> None:
    from .exporting import Wanted, export_project

    wanted = Wanted(arguments.models, arguments.out, arguments.posed, not arguments.without_detector)
    print("\n".join(export_project(arguments.project, arguments.object, wanted)))
    print("next, `posed objects add NAME.posed`, or PUT it to /v1/objects/NAME of a running server")


def positive(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text}: must be above 0")
    return value


def whole(least: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        value = int(text)
        if value < least:
            raise argparse.ArgumentTypeError(f"{text}: at least {least}")
        return value

    return number
