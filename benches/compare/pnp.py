"""The same PnP problems through posed, OpenCV and PoseLib, in one run and on one thread; prints a Markdown table.

usage: python benches/compare/pnp.py OUT.md    (as `make bench-pnp` does)

Every method sees a problem in the same moment, method by method, and is timed five times; the fastest of the five
counts, and the median over problems is printed. OpenCV and PoseLib are called through their Python bindings, which adds
a few microseconds to each call; the line "call" is the time of an OpenCV function that does nothing but be called.
"""

import json
import os
import pathlib
import platform
import subprocess
import sys
import tempfile
import time

os.environ["OMP_NUM_THREADS"] = "1"

import cv2
import numpy as np
import poselib

cv2.setNumThreads(1)
ROOT = pathlib.Path(__file__).resolve().parents[2]
F, CX, CY = 600.0, 319.5, 239.5
K = np.array([[F, 0, CX], [0, F, CY], [0, 0, 1.0]])
PROBLEMS = 2000
REPEATS = 5
CUBE = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * 0.08 / np.sqrt(3)


def random_rotation(rng):
    x, y, z, w = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def shell(rng, count):
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(0.05, 0.1, (count, 1))


def problem(rng, count, kind):
    points = CUBE if kind.startswith(("outliers", "symmetric", "neighbour")) else shell(rng, count)
    if kind == "planar":
        points = points * [1, 1, 0]
    rotation = random_rotation(rng)
    translation = np.array([rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), rng.uniform(0.56, 1.04)])

    def project(rotation, translation):
        in_camera = points @ rotation.T + translation
        return in_camera[:, :2] / in_camera[:, 2:] * F + [CX, CY]

    pixels = project(rotation, translation)
    roots = np.tile(np.eye(2), (count, 1, 1))
    if kind == "unequal":
        # Standard deviations of 0.5 to 8 px, up to four times as long as wide.
        long = 0.5 * 16 ** rng.uniform(size=count)
        short = np.maximum(long / rng.uniform(1, 4, count), 0.5)
        angle = rng.uniform(0, np.pi, count)
        turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], -1).reshape(-1, 2, 2)
        roots = turn * np.stack([long, short], -1)[:, None]
    pixels = pixels + np.einsum("nij,nj->ni", roots, rng.normal(size=(count, 2)))
    outliers = int(kind.split()[-1]) if kind[-1].isdigit() else 0
    victims = rng.choice(count, outliers, replace=False)
    if kind.startswith("outliers"):
        pixels[victims] = [F * translation[0] / translation[2] + CX, F * translation[1] / translation[2] + CY]
        pixels[victims] += rng.uniform(-75, 75, (outliers, 2))
    if kind.startswith("symmetric"):
        pixels[victims] = project(rotation @ np.diag([-1.0, -1.0, 1.0]), translation)[victims]
    if kind.startswith("neighbour"):
        aside = rng.normal(size=3)
        pixels[victims] = project(random_rotation(rng), translation + 0.1 * aside / np.linalg.norm(aside))[victims]
    covariances = roots @ roots.transpose(0, 2, 1)
    return {"points": points, "pixels": pixels, "covariances": covariances, "R": rotation, "t": translation}


def opencv(flag, refine=False):
    def run(p):
        found, rvec, tvec = cv2.solvePnP(p["points"], p["pixels"], K, None, flags=flag)
        if found and refine:
            rvec, tvec = cv2.solvePnPRefineLM(p["points"], p["pixels"], K, None, rvec, tvec)
        return (cv2.Rodrigues(rvec)[0], tvec[:, 0]) if found else None

    return run


def pose_lib(p):
    camera = {"model": "PINHOLE", "width": 640, "height": 480, "params": [F, F, CX, CY]}
    ransac = {"max_reproj_error": 8.0, "min_iterations": 100, "max_iterations": 1000}
    pose, _ = poselib.estimate_absolute_pose(p["pixels"], p["points"], camera, ransac, {})
    return pose.R, pose.t


PEERS = {
    "OpenCV EPNP": opencv(cv2.SOLVEPNP_EPNP),
    "OpenCV SQPNP": opencv(cv2.SOLVEPNP_SQPNP),
    "OpenCV SQPNP + RefineLM": opencv(cv2.SOLVEPNP_SQPNP, refine=True),
    "OpenCV ITERATIVE": opencv(cv2.SOLVEPNP_ITERATIVE),
    "PoseLib LO-RANSAC": pose_lib,
}


def timed(run, p):
    """The answer and the fastest of some calls, microseconds; a method that raises has no answer."""
    fastest, answer = np.inf, None
    for _ in range(REPEATS):
        start = time.perf_counter()
        try:
            answer = run(p)
        except cv2.error:
            answer = None
        fastest = min(fastest, time.perf_counter() - start)
    return answer, 1e6 * fastest


def posed(problems):
    """posed solves in its own process, in the same minute."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "problems.json"
        content = {
            "camera": {"model": "pinhole", "fx": F, "fy": F, "cx": CX, "cy": CY},
            "problems": [
                {
                    "points_m": p["points"].tolist(),
                    "pixels": p["pixels"].tolist(),
                    "covariances_px2": p["covariances"].tolist(),
                }
                for p in problems
            ],
        }
        path.write_text(json.dumps(content))
        command = ["cargo", "bench", "--quiet", "--locked", "--package", "posed-core", "--bench", "pnp"]
        subprocess.run(command, cwd=ROOT, env=os.environ | {"POSED_PROBLEMS": str(path)}, check=True)
        answers = json.loads(path.with_suffix(".answers").read_text())
    poses = [None if a["matrix"] is None else np.array(a["matrix"]) for a in answers]
    poses = [None if m is None else (m[:3, :3], m[:3, 3]) for m in poses]
    return poses, [a["microseconds"] for a in answers], [a["ok"] for a in answers]


def errors(poses, problems):
    """Rotation (degrees) and translation (millimetres) errors; 180 and infinity where there is no answer."""
    angles, shifts = [], []
    for pose, p in zip(poses, problems, strict=True):
        if pose is None or not np.isfinite(pose[0]).all():
            angles.append(180.0)
            shifts.append(np.inf)
            continue
        chord = np.linalg.norm(pose[0] - p["R"]) / np.sqrt(8)
        angles.append(2 * np.degrees(np.arcsin(min(chord, 1.0))))
        shifts.append(1e3 * np.linalg.norm(pose[1] - p["t"]))
    return np.array(angles), np.array(shifts)


def row(name, times, poses, problems, accepted_wrong=None):
    angles, shifts = errors(poses, problems)
    accepted = "" if accepted_wrong is None else f"{100 * accepted_wrong:.2f} %"
    return (
        f"| {name} | {np.median(times):.1f} | {100 * np.mean(angles > 10):.2f} % | {accepted} "
        f"| {np.median(angles):.2f} / {np.percentile(angles, 95):.2f} "
        f"| {np.median(shifts):.1f} / {np.percentile(shifts, 95):.1f} |"
    )


def section(title, count, kind, seed):
    rng = np.random.default_rng(seed)
    problems = [problem(rng, count, kind) for _ in range(PROBLEMS)]
    print(title, file=sys.stderr)
    poses, times, ok = posed(problems)
    wrong = errors(poses, problems)[0] > 10
    lines = [
        f"\n## {title}\n",
        "| Method | µs | > 10° | of these accepted | rotation median / p95, ° | translation median / p95, mm |",
        "|---|---:|---:|---:|---:|---:|",
        row("**posed**", times, poses, problems, np.mean(wrong & np.array(ok))),
    ]
    for name, run in PEERS.items():
        answers, times = zip(*(timed(run, p) for p in problems), strict=True)
        lines.append(row(name, times, answers, problems))
    return lines


def main():
    call = timed(lambda _: cv2.norm(K), None)[1]
    lines = [
        "# Pose from points: posed, OpenCV, PoseLib",
        "",
        f"`make bench-pnp` writes this page: {PROBLEMS:,} random problems a table, object of 0.1 to 0.2 m at 0.56 to "
        "1.04 m, f = 600 px, one thread. The time is the median over problems of the fastest of five calls. posed's includes "
        "covariance, alternatives, residuals and status; its time is taken inside the process, the others' through Python, "
        f"which costs {call:.1f} µs a call (a few more for conversions). Compare ratios, not machines.",
        "",
        f"OpenCV {cv2.__version__}, PoseLib {poselib.__version__}, {platform.machine()}. \"> 10°\": poses with more than 10 "
        "degrees of rotation error. \"of these accepted\": share of all problems whose wrong pose had status `ok`.",
    ]
    lines += section("4 points, 1 px", 4, "general", 1)
    lines += section("6 points, 1 px", 6, "general", 2)
    lines += section("8 points, 1 px", 8, "general", 3)
    lines += section("12 points, 1 px", 12, "general", 4)
    lines += section("8 points of a plane, 1 px", 8, "planar", 5)
    lines += section("8 points, each with its own known covariance (0.5 to 8 px)", 8, "unequal", 6)
    for outliers in (1, 2, 3):
        lines += section(f"8 corners of a cube, 1 px, {outliers} of them anywhere", 8, f"outliers {outliers}", 6 + outliers)
    lines += section("8 corners of a cube, 1 px, 2 of them on the wrong side of a half turn", 8, "symmetric 2", 10)
    lines += section("8 corners of a cube, 1 px, 2 of them on a neighbour", 8, "neighbour 2", 11)
    pathlib.Path(sys.argv[1]).write_text("\n".join(lines) + "\n")


main()
