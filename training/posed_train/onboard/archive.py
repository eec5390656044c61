"""A bundle: one object in one file, as posed reads it. The same object gives the same bytes."""

import hashlib
import io
import json
import os
import tarfile
import tempfile
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

FORMAT, VERSION = "posed-bundle", 1
ENDING = ".posed"
MANIFEST = "bundle.json"
MODE = 0o644


def write_bundle(path: Path, name: str, files: Mapping[str, bytes]) -> None:
    """`files` by their names in the bundle; a reader sees the old bundle or the new one, never a part."""
    stated = {
        file: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
        for file, content in sorted(files.items())
    }
    manifest = {"format": FORMAT, "version": VERSION, "name": name, "files": stated, "made_by": made_by()}
    contents = {MANIFEST: (json.dumps(manifest, indent=1) + "\n").encode()} | dict(sorted(files.items()))
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, part = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file, tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as tar:
            for file_name, content in contents.items():
                entry = tarfile.TarInfo(file_name)  # no owner, and the time 0
                entry.size, entry.mode = len(content), MODE
                tar.addfile(entry, io.BytesIO(content))
        os.chmod(part, MODE)
        os.replace(part, path)
    except BaseException:
        Path(part).unlink(missing_ok=True)
        raise


def made_by() -> str:
    return f"posed-train {metadata.version('posed-train')}"
