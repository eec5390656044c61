"""The folder of one project: `object.toml`, to be read and edited by people, and a BOP dataset inside.

NAME/object.toml            what is known of the objects, and where the photos come from
     camera.json            the camera, as posed reads it, if the photos told it
     train/000000/          one scene (component) a source of photos, BOP's format
          photos.json       which photo each image was
"""

import json
import math
import os
import re
import shutil
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path

from ..bop import DatasetError
from .symmetry import motions

SETTINGS = "object.toml"
SPLIT = "train"
PHOTOS = "photos.json"
SOLIDS = ("box", "cylinder")
UPS = ("z", "y", "x", "-z", "-y", "-x")
NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


@dataclass
class Item:
    """One object of a project. Its frame is that of its box: origin in the middle, z (or `up`) up where it stood."""

    name: str
    obj_id: int
    solid: str = "box"
    size_mm: list[float] = field(default_factory=list)
    """Of the box along its axes, empty until `label`."""
    up: str = "z"
    """The axis of its frame that points up where it stood."""
    symmetries: list[str] = field(default_factory=list)
    """Turns that it looks the same after: "z2" is half a turn about z, "x4" a quarter about x, "z" any about z."""


@dataclass
class Project:
    folder: Path
    items: list[Item]
    sources: list[dict] = field(default_factory=list)
    """How each scene was made."""

    @property
    def split(self) -> Path:
        return self.folder / SPLIT

    @property
    def scenes(self) -> list[Path]:
        return sorted(p for p in self.split.iterdir() if (p / "scene_gt_info.json").exists())

    def item(self, name: str) -> Item:
        for item in self.items:
            if item.name == name:
                return item
        known = ", ".join(item.name for item in self.items)
        raise DatasetError(f"{self.folder / SETTINGS}: no object {name!r}; it has {known}")

    def save(self) -> None:
        lines = ["# Written by posed-train. Names, sizes and symmetries may be edited."]
        for kind, tables in (("object", [vars(item) for item in self.items]), ("photos", self.sources)):
            for table in tables:
                lines += ["", f"[[{kind}]]"] + [f"{key} = {toml(value)}" for key, value in table.items()]
        replace_text(self.folder / SETTINGS, "\n".join(lines) + "\n")


def toml(value: object) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(one) for one in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else f"{value}"


def replace_text(path: Path, text: str) -> None:
    """All of it or nothing."""
    part = path.with_name(path.name + ".part")
    part.write_text(text)
    os.replace(part, path)


def check_name(name: str) -> str:
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise DatasetError(f"object name {name!r}: small letters, digits, - and _, at most 64")
    if name == "detector":
        raise DatasetError("object name 'detector': the folder of models keeps its detector under that name")
    return name


def create(folder: Path, names: list[str]) -> Project:
    names = names or [folder.resolve().name]
    if len(set(names)) < len(names):
        raise DatasetError(f"objects {', '.join(names)}: each name once")
    if (folder / SETTINGS).exists():
        raise DatasetError(f"{folder} is a project already; `posed-train add` gives it more photos")
    if folder.exists() and any(folder.iterdir()):
        raise DatasetError(f"{folder} exists and is not empty; name a new folder")
    return Project(folder, [Item(check_name(name), number) for number, name in enumerate(names, 1)])


def is_project(folder: Path) -> bool:
    return folder.is_dir()


def load(folder: Path) -> Project:
    path = folder / SETTINGS
    try:
        values = tomllib.loads(path.read_text())
    except IsADirectoryError:
        raise DatasetError(f"{path}: a folder; it must be a file") from None
    except OSError:
        raise DatasetError(f"{path}: missing; `posed-train new {folder} PHOTOS` makes a project") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: {error}") from None
    tables = values.get("object")
    if not isinstance(tables, list) or not tables:
        raise DatasetError(f"{path}: needs [[object]] with name and obj_id")
    items = [read_item(table, path) for table in tables]
    for what in ("name", "obj_id"):
        values_of = [getattr(item, what) for item in items]
        if len(set(values_of)) < len(items):
            raise DatasetError(f"{path}: two objects have the same {what}")
    sources = values.get("photos", [])
    if not isinstance(sources, list) or not all(isinstance(source, dict) for source in sources):
        raise DatasetError(f"{path}: photos must be [[photos]]")
    return Project(folder, items, sources)


def read_item(table: object, path: Path) -> Item:
    if not isinstance(table, dict):
        raise DatasetError(f"{path}: needs [[object]] with name and obj_id")
    unknown = set(table) - {field.name for field in fields(Item)}
    if unknown:
        raise DatasetError(f"{path}: unknown setting {sorted(unknown)[0]!r} in [[object]]")
    try:
        item = Item(**table)
    except TypeError:
        raise DatasetError(f"{path}: [[object]] needs name and obj_id") from None
    check_name(item.name)
    if not isinstance(item.obj_id, int) or item.obj_id < 1:
        raise DatasetError(f"{path}: obj_id {item.obj_id!r}: a number, 1 or more")
    if item.solid not in SOLIDS:
        raise DatasetError(f"{path}: solid {item.solid!r}: choose one of {', '.join(SOLIDS)}")
    size = item.size_mm
    good = isinstance(size, list) and all(isinstance(side, int | float) and 0 < side < math.inf for side in size)
    if not good or len(size) not in (0, 3):
        raise DatasetError(f"{path}: size_mm {size!r}: three lengths in millimetres, as [95, 60.5, 190]")
    if item.up not in UPS:
        raise DatasetError(f"{path}: up {item.up!r}: choose one of {', '.join(UPS)}")
    if not isinstance(item.symmetries, list) or not all(isinstance(one, str) for one in item.symmetries):
        raise DatasetError(f'{path}: symmetries {item.symmetries!r}: a list, as ["z2"]')
    try:
        motions(item.symmetries)
    except DatasetError as error:
        raise DatasetError(f"{path}: {error}") from None
    return item


@contextmanager
def new_folder(final: Path) -> Iterator[Path]:
    """A folder to fill, which appears under its name once it is whole; on an error nothing is left of it."""
    final.parent.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(prefix=f".{final.name}-", dir=final.parent))
    try:
        yield part
        part.chmod(0o755)
        if final.exists() and not any(final.iterdir()):
            final.rmdir()
        part.rename(final)
    finally:
        shutil.rmtree(part, ignore_errors=True)
