"""An exported keypoint net that computes in 8-bit integers: faster where the CPU has VNNI; less exact.

Static, per channel, activations calibrated on training crops (ONNX Runtime's own tool). Only the convolutions change:
the graph's inputs and outputs, and so the service, do not.
"""

import json
import tempfile
import time
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnxruntime.quantization import CalibrationDataReader, QuantType, quantize_static

from .bop import DatasetError, View
from .config import KeypointConfig
from .crops import first_crop
from .data import Views
from .export import covariance_scale, sha256, write_manifest, write_parity
from .exported import predictor
from .train import Validator
from .validate import Predictor

CALIBRATION_VIEWS = 200
TIMED_RUNS = 50


class Crops(CalibrationDataReader):
    def __init__(self, views: list[View], size: int):
        self.views, self.size = iter(views), size

    def get_next(self) -> dict[str, np.ndarray] | None:
        view = next(self.views, None)
        return view and {"image": first_crop(view, self.size)[0][None]}


def quantize(config: KeypointConfig, data: Path, model: Path, out: Path) -> dict[str, dict[str, float]]:
    """Writes the model folder `out`; returns the scores and milliseconds a crop of both networks."""
    manifest = json.loads((model / "object.json").read_text())
    views = Views(config, data)
    known = np.array(manifest["virtual_keypoints_m"])
    if known.shape != views.registration.keypoints.shape or not np.allclose(known, views.registration.keypoints):
        raise DatasetError(f"{model}: not trained with these settings on this data: the keypoints lie elsewhere")
    out.mkdir(parents=True)
    before, after = model / "keypoints.onnx", out / "keypoints.onnx"
    nets = {"float": predictor(before, views.heights)}
    quantize_network(before, after, Crops(calibration_views(views), nets["float"].size))
    nets["int8"] = predictor(after, views.heights)
    judging = [views.all[index] for index in views.judging]
    write_parity(lambda crops: nets["int8"].run(crops)[0], after, judging)
    manifest["model_sha256"] = sha256(after)
    scale = covariance_scale(nets["int8"], judging, views.targets(views.judging))
    manifest["covariance_scale"] = scale.round(4).tolist()
    validator, milliseconds = Validator(config, data, views), time_nets(nets)
    scores = {name: {"ms_per_crop": milliseconds[name], **validator.score(net)} for name, net in nets.items()}
    manifest["training"]["int8"] = {key: round(value, 2) for key, value in scores["int8"].items()}
    write_manifest(out / "object.json", manifest)
    return scores


def calibration_views(views: Views) -> list[View]:
    """Training views spread over the data, photoreal ones."""
    chosen = [view for index, view in enumerate(views.all[: views.photoreal_count]) if index not in views.held_out]
    return chosen[:: max(1, len(chosen) // CALIBRATION_VIEWS)]


def quantize_network(before: Path, after: Path, crops: Crops) -> None:
    with tempfile.TemporaryDirectory() as folder:
        # The tool wants plain 32-bit weights: ONNX Runtime folds the casts that follow the stored ones.
        plain = Path(folder) / "plain.onnx"
        options = onnxruntime.SessionOptions()
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
        options.optimized_model_filepath = str(plain)
        onnxruntime.InferenceSession(str(before), options, providers=["CPUExecutionProvider"])
        head = [node.name for node in onnx.load(plain).graph.node if node.op_type == "Conv"][-1]
        quantize_static(
            plain,
            after,
            crops,
            per_channel=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            op_types_to_quantize=["Conv", "Add", "Relu", "Clip", "Resize"],
            nodes_to_exclude=[head],  # its outputs are the logits: keypoints hang on small differences there
        )


def time_nets(nets: dict[str, Predictor]) -> dict[str, float]:
    """Median milliseconds a crop, both nets by turns."""
    crops = np.random.default_rng(0).integers(0, 256, (3, *[next(iter(nets.values())).size] * 2, 3), np.uint8)
    seconds = {name: [] for name in nets}
    for _ in range(TIMED_RUNS):
        for name, net in nets.items():
            started = time.perf_counter()
            net.run(crops)
            seconds[name].append(time.perf_counter() - started)
    return {name: 1000 * float(np.median(values)) / len(crops) for name, values in seconds.items()}


def table(scores: dict[str, dict[str, float]]) -> str:
    rows = ["| network | ms a crop | ADD(-S), % | 5°5cm, % | keypoint, median px |", "|---|---:|---:|---:|---:|"]
    for name, r in scores.items():
        quality = [
            f"{r[key]:.2f}" if key in r else "" for key in ("add_percent", "deg5_cm5_percent", "keypoint_median_px")
        ]
        rows.append(f"| {name} | {r['ms_per_crop']:.2f} | {' | '.join(quality)} |")
    return "\n".join(rows)
