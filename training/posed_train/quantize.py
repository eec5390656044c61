"""Exported networks that compute in 8-bit integers: three times as fast under OpenVINO where the processor has VNNI.

Static, weights per channel, activations calibrated on images (ONNX Runtime's own tool). Only the convolutions and what
lies between them change: the graph's inputs and outputs, and so the service, do not. The last convolutions stay in
float: keypoints and boxes hang on small differences there.
"""

import json
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import onnx
import onnxruntime
from onnxruntime.quantization import CalibrationDataReader, QuantType, quantize_static

from . import detector
from .bop import DatasetError, View, read_views
from .crops import first_crop
from .export import sha256, write_manifest
from .exported import session

CALIBRATION_IMAGES = 96
"""More did not change the figures."""
TIMED_RUNS = 30
MAX_SHIFT_PX = 0.5
"""Median distance of a keypoint from where the float network sees it; with more, that network stays."""
MIN_FOUND_AGAIN = 0.95
"""Share of the float network's boxes."""


class Images(CalibrationDataReader):
    def __init__(self, images: Iterable[np.ndarray]):
        self.images = iter(images)

    def get_next(self) -> dict[str, np.ndarray] | None:
        image = next(self.images, None)
        return None if image is None else {"image": image[None]}


def spread_over(items: list, count: int = CALIBRATION_IMAGES) -> list:
    return items[:: max(1, len(items) // count)][:count]


def quantize_network(before: Path, after: Path, images: Iterable[np.ndarray]) -> None:
    """`images`: `[H, W, 3]` uint8, such as the network will see."""
    with tempfile.TemporaryDirectory() as folder:
        # The tool wants plain 32-bit weights: ONNX Runtime folds the casts that follow the stored ones.
        plain = Path(folder) / "plain.onnx"
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
        options.optimized_model_filepath = str(plain)
        onnxruntime.InferenceSession(str(before), options, providers=["CPUExecutionProvider"])
        quantize_static(
            plain,
            after,
            Images(images),
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            op_types_to_quantize=["Conv", "Add", "Relu", "Clip", "Resize"],
            nodes_to_exclude=last_convolutions(onnx.load(plain).graph),
        )


def last_convolutions(graph: onnx.GraphProto) -> list[str]:
    """Names of the convolutions that none follows."""
    readers = {}
    for node in graph.node:
        for value in node.input:
            readers.setdefault(value, []).append(node)
    last = []
    for convolution in (node for node in graph.node if node.op_type == "Conv"):
        waiting, seen = list(convolution.output), set()
        while waiting:
            for reader in readers.get(waiting.pop(), []):
                if reader.name not in seen:
                    seen.add(reader.name)
                    waiting.extend(reader.output)
        if not any(node.op_type == "Conv" and node.name in seen for node in graph.node):
            last.append(convolution.name)
    return last


def quantize_keypoints(folder: Path, views: list[View]) -> str:
    """Lets the keypoint net of a model folder compute in 8 bits, calibrated on crops of these views. Says what it did:
    where keypoints move too far, the network stays as it is."""
    manifest = json.loads((folder / "object.json").read_text())
    size, name = manifest["input"]["size"], manifest["name"]
    crops = [first_crop(view, size)[0] for view in spread_over(views)]
    path = folder / "keypoints.onnx"
    found = lambda crops: lambda net: net.run(["keypoints"], {"image": crops})[0]  # noqa: E731
    with candidate(path, crops) as net:
        before, after = both(path, net, found(np.stack(crops)))
        shift = np.median(np.linalg.norm(after - before, axis=-1))
        if not shift <= MAX_SHIFT_PX:
            return f"{name}: stays in 32 bits; with 8 its keypoints move by {shift:.2f} px in the median"
        if (folder / "parity.json").exists():
            state_parity(folder, size, path)
        manifest["model_sha256"] = adopt(net, path)
    write_manifest(folder / "object.json", manifest)
    return f"{name}: computes in 8 bits; keypoints move by {shift:.2f} px in the median"


def state_parity(folder: Path, size: int, before: Path) -> None:
    """Providers round 8-bit networks differently, and each keypoint by its own luck: what is compared is the median
    distance from the float network."""
    crops = cv2.imread(str(folder / "parity.png"), cv2.IMREAD_COLOR_RGB).reshape(-1, size, size, 3)
    expected = session(before).run(["keypoints"], {"image": crops})[0]
    parity = {"keypoints_px": expected.astype(float).round(4).tolist(), "median_tolerance_px": 2 * MAX_SHIFT_PX}
    (folder / "parity.json").write_text(json.dumps(parity, indent=1) + "\n")


def quantize_detector(folder: Path, images: list[Path]) -> str:
    """The same for a detector, calibrated on images (files)."""
    manifest = json.loads((folder / "detector.json").read_text())
    read = lambda path: detector.letterbox(cv2.imread(str(path), cv2.IMREAD_COLOR_RGB))[0]  # noqa: E731
    seen = [read(path) for path in spread_over(images)]
    path = folder / "detector.onnx"
    found = lambda net: [net.run(["detections"], {"image": image[None]})[0][0] for image in seen]  # noqa: E731
    with candidate(path, seen) as net:
        share = found_again(*both(path, net, found), manifest["score_threshold"])
        if share < MIN_FOUND_AGAIN:
            return f"detector: stays in 32 bits; with 8 it finds {100 * share:.0f} % of the boxes again"
        manifest["model_sha256"] = adopt(net, path)
    write_manifest(folder / "detector.json", manifest)
    return f"detector: computes in 8 bits; {100 * share:.1f} % of the boxes are found again"


def found_again(before: list[np.ndarray], after: list[np.ndarray], threshold: float) -> float:
    """The share of boxes `[N, 6]` (x1, y1, x2, y2, score, class) that have one of their class on them."""
    total = again = 0
    for expected, rows in zip(before, after):
        rows = rows[rows[:, 4] >= threshold / 2]
        for box in expected[expected[:, 4] >= threshold]:
            low, high = np.maximum(rows[:, :2], box[:2]), np.minimum(rows[:, 2:4], box[2:4])
            common = np.clip(high - low, 0, None).prod(axis=1)
            areas = (rows[:, 2:4] - rows[:, :2]).prod(axis=1) + (box[2:4] - box[:2]).prod()
            total += 1
            again += bool(((common > 0.5 * (areas - common)) & (rows[:, 5] == box[5])).any())
    return again / total if total else 1.0


@contextmanager
def candidate(path: Path, images: list[np.ndarray]) -> Iterator[Path]:
    """An 8-bit copy of a network, beside it until it is taken or not."""
    if not images:
        raise DatasetError(f"{path}: no images to calibrate 8-bit numbers on")
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        after = Path(folder) / path.name
        quantize_network(path, after, images)
        yield after


def both(before: Path, after: Path, run: Callable) -> tuple:
    return run(session(before)), run(session(after))


def adopt(after: Path, path: Path) -> str:
    after.replace(path)
    return sha256(path)


def quantize(model: Path, out: Path, split: Path) -> str:
    """Copies a model folder, of an object or the detector, and lets the copy compute in 8 bits."""
    shutil.copytree(model, out)
    if (out / "detector.json").exists():
        network = "detector.onnx"
        said = quantize_detector(out, sorted(split.glob("*/rgb/*")))
    else:
        network = "keypoints.onnx"
        views = read_views(split, json.loads((out / "object.json").read_text())["obj_id"])
        said = quantize_keypoints(out, views)
    before, after = milliseconds([model / network, out / network])
    return f"{said}; {before:.1f} -> {after:.1f} ms on ONNX Runtime's CPU provider"


def milliseconds(networks: list[Path]) -> list[float]:
    """Median of one image, by turns."""
    nets = [session(path) for path in networks]
    shape = [side if isinstance(side, int) else 1 for side in nets[0].get_inputs()[0].shape]
    image = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    seconds = [[] for _ in nets]
    for _ in range(TIMED_RUNS):
        for net, taken in zip(nets, seconds):
            started = time.perf_counter()
            net.run(None, {"image": image})
            taken.append(time.perf_counter() - started)
    return [1000 * float(np.median(taken)) for taken in seconds]
