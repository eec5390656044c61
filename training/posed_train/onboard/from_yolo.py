"""Labels of YOLO: a text file an image, `class x y width height` or an outline, in shares of the image's size."""

import re
from pathlib import Path

import numpy as np

from ..bop import DatasetError
from .given import Given, of_box, of_polygons

CLASSES = ("classes.txt", "obj.names")
DATA = ("data.yaml", "dataset.yaml")
BOX, BOX_WITH_SCORE = 5, 6


def read_yolo(folder: Path) -> list[Given]:
    if not folder.is_dir():
        raise DatasetError(f"{folder}: give the folder of YOLO's text files")
    names = class_names(folder)
    found = []
    for path in sorted(folder.glob("*.txt")):
        if path.name not in CLASSES:
            lines = path.read_text(errors="replace").splitlines()
            found += [
                read_line(line, f"{path}: line {k}", path.stem, names)
                for k, line in enumerate(lines, 1)
                if line.split()
            ]
    if not found:
        raise DatasetError(f"{folder}: no text file with a label")
    return found


def class_names(folder: Path) -> dict[int, str]:
    """Of the file of classes beside the labels, or above them."""
    for place in (folder, folder.parent, folder.parent.parent):
        for name in CLASSES:
            if (place / name).is_file():
                return dict(enumerate(line.strip() for line in (place / name).read_text().splitlines()))
        for name in DATA:
            if (place / name).is_file():
                return names_in(place / name)
    raise DatasetError(f"{folder}: no classes.txt or data.yaml there or above: it names the classes")


def names_in(path: Path) -> dict[int, str]:
    """The `names` of a data.yaml, in any of the three ways that tools write them."""
    text = re.sub(r"(?m)\s*#.*$", "", path.read_text())
    listed = re.search(r"(?ms)^names:\s*\[(.*?)\]", text)
    if listed:
        return dict(enumerate(clean(name) for name in listed[1].split(",")))
    block = re.search(r"(?m)^names:[ \t]*\n((?:[ \t]*(?:-|\d+:).*\n?)+)", text)
    if block is None:
        raise DatasetError(f"{path}: has no `names` of the classes")
    rows = [row.strip() for row in block[1].splitlines() if row.strip()]
    if rows[0].startswith("-"):
        return dict(enumerate(clean(row[1:]) for row in rows))
    return {int(number): clean(name) for number, name in (row.split(":", 1) for row in rows)}


def clean(text: str) -> str:
    return text.strip().strip("'\"")


def read_line(line: str, where: str, stem: str, names: dict[int, str]) -> Given:
    try:
        first, *values = [float(word) for word in line.split()]
        number = int(first)
    except ValueError:
        raise DatasetError(f"{where}: not numbers") from None
    if number not in names or number != first:
        raise DatasetError(f"{where}: class {first:g} has no name")
    if not all(-0.01 <= value <= 1.01 for value in values):
        raise DatasetError(f"{where}: YOLO's numbers are shares of width and height, from 0 to 1; these are not")
    if len(values) + 1 in (BOX, BOX_WITH_SCORE):
        x, y, w, h = values[:4]
        return of_box([x - w / 2, y - h / 2, w, h], where, stem, names[number], None)
    if len(values) < 6 or len(values) % 2:
        raise DatasetError(f"{where}: a class and four numbers are a box, a class and pairs of numbers an outline")
    return of_polygons([np.array(values).reshape(-1, 2)], where, stem, names[number], None)
