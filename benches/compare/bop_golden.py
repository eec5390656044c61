"""Writes tests/data/bop_toolkit.json: what the BOP toolkit makes of some poses, in millimetres, pixels and degrees.

usage: PYTHONPATH=BOP_TOOLKIT python benches/compare/bop_golden.py COMMIT OUT.json

BOP_TOOLKIT is a checkout of github.com/thodan/bop_toolkit at COMMIT (its functions need numpy and scipy). The file in the
repository is of commit cea62d651c7e395b2e1962b9749e4e89693c6ac4, numpy 2.4.6 and scipy 1.17.1.
"""

import json
import sys

import numpy as np
from bop_toolkit_lib import misc, pose_error
from scipy.spatial.transform import Rotation

K = np.array([[612.0, 0.0, 319.5], [0.0, 598.0, 239.5], [0.0, 0.0, 1.0]])
MAX_SYM_DISC_STEP = 0.01
VERTICES = 30
# How far an estimate is from the truth: rotation vector (rad) and translation (mm) of such a length.
OFFSETS = {"near": (0.02, 2.0), "off": (0.3, 20.0), "turned": (3.0, 5.0), "far": (1.5, 400.0)}


def turn(axis, degrees, offset=(0.0, 0.0, 0.0)):
    """A 4x4 turn about an axis through a point, in mm."""
    axis = np.array(axis) / np.linalg.norm(axis)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
    matrix[:3, 3] = np.array(offset) - matrix[:3, :3] @ np.array(offset)
    return matrix.flatten().tolist()


# Whole groups, but for the identity.
SYMMETRIES = {
    "none": {},
    "half turn": {"symmetries_discrete": [turn([0, 0, 1], 180)]},
    "half turn beside the origin": {"symmetries_discrete": [turn([1, 2, 2], 180, [10.0, -4.0, 3.0])]},
    "quarter turns": {"symmetries_discrete": [turn([0, 1, 0], angle) for angle in (90, 180, 270)]},
    "box": {"symmetries_discrete": [turn(axis, 180) for axis in np.eye(3)]},
    "axis": {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]},
    "axis beside the origin": {"symmetries_continuous": [{"axis": [0.6, 0.0, 0.8], "offset": [5.0, -8.0, 2.0]}]},
    "can": {
        "symmetries_discrete": [turn([1, 0, 0], 180)],
        "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}],
    },
}


def any_vector(rng, length):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector) * length


def case(rng, symmetries, offset):
    points = rng.uniform([-40.0, -25.0, -60.0], [40.0, 25.0, 60.0], (VERTICES, 3))
    angle, shift = OFFSETS[offset]
    r_true = Rotation.random(random_state=rng).as_matrix()
    t_true = rng.uniform([-100.0, -80.0, 500.0], [100.0, 80.0, 900.0]).reshape(3, 1)
    r_estimate = Rotation.from_rotvec(any_vector(rng, angle)).as_matrix() @ r_true
    t_estimate = t_true + any_vector(rng, shift).reshape(3, 1)
    info = SYMMETRIES[symmetries]
    group = misc.get_symmetry_transformations(info, MAX_SYM_DISC_STEP)
    poses = (r_estimate, t_estimate, r_true, t_true)
    expected = {
        "add": pose_error.add(*poses, points),
        "adi": pose_error.adi(*poses, points),
        "mssd": pose_error.mssd(*poses, points, group),
        "mspd": pose_error.mspd(*poses, K, points, group),
        "proj": pose_error.proj(*poses, K, points),
    }
    # The toolkit's steps of an axis are not the nearest pose of all.
    if "symmetries_continuous" not in info:
        equals = [(r_true @ one["R"], r_true @ one["t"] + t_true) for one in group]
        errors = [(pose_error.re(r_estimate, r), pose_error.te(t_estimate, t)) for r, t in equals]
        expected["re"], expected["te"] = min(errors)
    return {
        "name": f"{symmetries}, {offset}",
        "points_mm": points.tolist(),
        "symmetries": info,
        "truth": {"rotation": r_true.flatten().tolist(), "translation_mm": t_true.flatten().tolist()},
        "estimate": {"rotation": r_estimate.flatten().tolist(), "translation_mm": t_estimate.flatten().tolist()},
        "expected": {name: float(value) for name, value in expected.items()},
    }


def main():
    commit, out = sys.argv[1:]
    rng = np.random.default_rng(11)
    cases = [case(rng, symmetries, offset) for symmetries in SYMMETRIES for offset in OFFSETS]
    camera = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    with open(out, "w") as file:
        file.write(f'{{"bop_toolkit": "{commit}", "camera": {json.dumps(camera)}, "cases": [\n')
        file.write(",\n".join(json.dumps(one) for one in cases))
        file.write("\n]}\n")


main()
