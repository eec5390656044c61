"""Writes core/tests/data/opencv_cameras.json: what OpenCV makes of some points and pixels with every lens model.

usage: python benches/compare/camera_golden.py OUT.json
"""

import json
import sys

import cv2
import numpy as np

LENSES = {
    "pinhole": ("pinhole", []),
    "plumb bob": ("opencv", [-0.28, 0.09, 0.0011, -0.0007, -0.013]),
    "rational": ("opencv", [0.31, -0.12, 0.0006, -0.0009, 0.004, 0.62, -0.21, 0.015]),
    "thin prism": ("opencv", [-0.21, 0.07, 0.0009, 0.0004, -0.01, 0.02, 0.003, -0.001, 0.0011, -0.0004, -0.0008, 0.0002]),
    "fisheye": ("fisheye", [-0.021, 0.0083, -0.0041, 0.0007]),
    "wide fisheye": ("fisheye", [0.076, -0.031, 0.012, -0.0031]),
}
K = np.array([[612.0, 0.0, 319.5], [0.0, 598.0, 239.5], [0.0, 0.0, 1.0]])
EXACT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-14)


def project(model, points, distortion):
    zero = np.zeros(3)
    if model == "fisheye":
        return cv2.fisheye.projectPoints(points[:, None], zero, zero, K, distortion)[0][:, 0]
    return cv2.projectPoints(points, zero, zero, K, distortion if distortion.size else None)[0][:, 0]


def unproject(model, pixels, distortion):
    if model == "fisheye":
        return cv2.fisheye.undistortPoints(pixels[:, None], K, distortion, criteria=EXACT)[:, 0]
    return cv2.undistortPoints(pixels[:, None], K, distortion if distortion.size else None, criteria=EXACT)[:, 0]


def main():
    rng = np.random.default_rng(5)
    cases = []
    for name, (model, coefficients) in LENSES.items():
        reach = 1.5 if model == "fisheye" else 0.55
        rays = rng.uniform(-reach, reach, (12, 2))
        depth = rng.uniform(0.3, 4.0, (12, 1))
        points = np.hstack([rays * depth, depth])
        distortion = np.array(coefficients)
        pixels = project(model, points, distortion)
        cases.append(
            {
                "name": name,
                "camera": {"model": model, "fx": 612.0, "fy": 598.0, "cx": 319.5, "cy": 239.5, "distortion": coefficients},
                "points_in_camera_m": points.tolist(),
                "pixels": pixels.tolist(),
                "rays": unproject(model, pixels, distortion).tolist(),
            }
        )
    with open(sys.argv[1], "w") as out:
        json.dump({"opencv": cv2.__version__, "cases": cases}, out, indent=1)
        out.write("\n")


main()
