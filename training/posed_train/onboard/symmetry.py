"""Turns after which an object looks the same, as people write them: "z2" is half a turn about z, "z" any about it."""

import re
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ..bop import DatasetError

TURN = re.compile(r"([xyz])(\d{0,2})")
STEPS_OF_ANY = 24
"""An axis of revolution, in steps."""
MOST = 60
"""The largest finite group of turns that is not of one axis is the icosahedron's."""


def motions(symmetries: Sequence[str]) -> list[list[float]]:
    """All turns but the identity, as in BOP's `models_info.json` (4x4, row by row): those told, and what follows."""
    generators = [generator(text) for text in symmetries]
    group = [np.eye(3)]
    for member in group:  # grows while it is gone through
        for turn in generators:
            product = member @ turn
            if not any(np.allclose(product, known, atol=1e-6) for known in group):
                group.append(product)
        if len(group) > MOST:
            raise DatasetError(f"symmetries {list(symmetries)}: they make more than {MOST} turns; tell fewer")
    return [as_matrix(turn).ravel().tolist() for turn in group[1:]]


def generator(text: str) -> np.ndarray:
    found = TURN.fullmatch(text)
    count = int(found[2] or STEPS_OF_ANY) if found else 0
    if count < 2:
        raise DatasetError(f'symmetry {text!r}: write "z2" for half a turn about z, "x4" for a quarter, "z" for any')
    return Rotation.from_euler(found[1], 360 / count, degrees=True).as_matrix()


def as_matrix(turn: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = turn
    return pose.round(9)
