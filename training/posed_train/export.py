"""Networks to ONNX, with pre- and post-processing inside the graph: raw 8-bit RGB in, a few numbers out.

Weights are stored in 8 bits, with one scale for each output channel (a Cast and a Mul follow; ONNX Runtime folds them
when it loads the file, and computes in 32-bit floats), so they are rounded to that precision before anything is
measured.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from PIL import Image
from torch import Tensor, nn

from . import detector
from .bop import View
from .crops import CROP_SCALE, ZOOM, first_crop
from .data import Views
from .exported import predictor, session
from .familiar import Unfamiliarity, unfamiliarity
from .heatmap import Decode, SecondPeak
from .network import KeypointNet
from .validate import CROP_ENSEMBLE, Predictor, predict_views

OPSET = 18
MIN_STORED_AS_BYTES = 1024  # elements: small tensors keep full precision
PARITY_TOLERANCE_PX = 0.02
PARITY_CROPS = 3
MAX_DETECTIONS_PER_CLASS = 32  # more would not help: the service takes so many of an image


KEYPOINT_OUTPUTS = ("keypoints", "covariances", "peaks", "second_keypoints", "second_weights", "unfamiliarity")


class KeypointExport(nn.Module):
    """`[B, S, S, 3]` uint8 -> what KEYPOINT_OUTPUTS names: `[B, N, 2]` and `[B, N, 2, 2]` in crop pixels, `[B, N]`;
    the second peaks' `[B, N, 2]` and `[B, N]`; `[B]`."""

    def __init__(self, net: KeypointNet, unfamiliarity: Unfamiliarity):
        super().__init__()
        cells = net.input_size // net.stride
        self.net, self.decode, self.second = net, Decode(cells, net.stride), SecondPeak(cells, net.stride)
        self.unfamiliarity = unfamiliarity

    def forward(self, crops: Tensor) -> tuple[Tensor, ...]:
        logits, features = self.net.with_features(crops.permute(0, 3, 1, 2).float() / 255)
        return (*self.decode(logits), *self.second(logits), self.unfamiliarity(features))


class DetectorExport(nn.Module):
    """`[1, H, W, 3]` uint8 -> boxes `[1, A, 4]` (x1, y1, x2, y2 edges) and scores `[1, C, A]`, before suppression."""

    def __init__(self, model):
        super().__init__()
        self.backbone, self.head = model.backbone, model.head
        mean, std = (torch.tensor(v).view(1, 3, 1, 1) for v in (model.transform.image_mean, model.transform.image_std))
        self.register_buffer("mean", mean)
        self.register_buffer("std", std)
        centres, sizes = [], []
        for stride in detector.STRIDES:
            rows, columns = (-(-side // stride) for side in (detector.HEIGHT, detector.WIDTH))
            # As AnchorGenerator places them: a grid whose step is the image's side over the map's side, from 0.
            y, x = torch.meshgrid(
                torch.arange(rows) * (detector.HEIGHT // rows),
                torch.arange(columns) * (detector.WIDTH // columns),
                indexing="ij",
            )
            centres.append(torch.stack([x, y], dim=-1).view(-1, 2).float())
            sizes.append(torch.full((rows * columns, 1), float(stride)))
        self.register_buffer("centres", torch.cat(centres))
        self.register_buffer("sizes", torch.cat(sizes))

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        pixels = (image.permute(0, 3, 1, 2).float() / 255 - self.mean) / self.std
        outputs = self.head(list(self.backbone(pixels).values()))
        scores = (outputs["cls_logits"].sigmoid() * outputs["bbox_ctrness"].sigmoid()).sqrt()
        distances = outputs["bbox_regression"] * self.sizes
        boxes = torch.cat([self.centres - distances[..., :2], self.centres + distances[..., 2:]], dim=-1)
        return boxes, scores.transpose(1, 2)


def to_bytes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The integers -127..127 `[O, ...]` and scales `[O, 1, ...]` whose products are nearest to these weights.

    Scales have 12 significant bits, so that the products are exact and are turned into the same integers again."""
    peaks = np.abs(values).max(axis=tuple(range(1, values.ndim)), keepdims=True)
    mantissas, exponents = np.frexp(np.where(peaks > 0, peaks / 127, 1))
    scales = np.ldexp(np.round(mantissas * 2**12) / 2**12, exponents).astype(np.float32)
    return np.clip(np.round(values / scales), -127, 127).astype(np.int8), scales


def round_to_bytes(module: nn.Module) -> None:
    """Rounds the weights that will be stored in 8 bits."""
    with torch.no_grad():
        for value in module.parameters():
            if value.numel() >= MIN_STORED_AS_BYTES:
                integers, scales = to_bytes(value.numpy())
                value.copy_(torch.from_numpy(integers * scales))


def fold_batch_norms(module: nn.Module) -> None:
    """Folds every convolution's batch normalisation into its weights, in place; for inference only."""
    module.eval()
    for child in module.children():
        fold_batch_norms(child)
    if isinstance(module, nn.Sequential):
        for i in range(len(module) - 1):
            if isinstance(module[i], nn.Conv2d) and isinstance(module[i + 1], nn.BatchNorm2d):
                module[i] = torch.nn.utils.fuse_conv_bn_eval(module[i], module[i + 1])
                module[i + 1] = nn.Identity()


def to_onnx(module: nn.Module, example: Tensor, outputs: list[str], dynamic_batch: bool) -> onnx.ModelProto:
    batch = torch.export.Dim("batch", min=1, max=256)
    program = torch.onnx.export(
        module.eval(),
        (example,),
        input_names=["image"],
        output_names=outputs,
        opset_version=OPSET,
        dynamo=True,
        dynamic_shapes=({0: batch},) if dynamic_batch else None,
        verbose=False,
    )
    return store_as_bytes(program.model_proto)


def store_as_bytes(model: onnx.ModelProto) -> onnx.ModelProto:
    scaled, all_scales = [], []
    for weight in model.graph.initializer:
        if weight.data_type != TensorProto.FLOAT or np.prod(weight.dims) < MIN_STORED_AS_BYTES:
            continue
        values = numpy_helper.to_array(weight)
        integers, scales = to_bytes(values)
        if not np.array_equal(integers * scales, values):
            continue  # not one of the rounded weights
        name = weight.name
        stored, whole, scale = (f"{name}_{part}" for part in ("integers", "whole", "scale"))
        weight.CopyFrom(numpy_helper.from_array(integers, stored))
        all_scales.append(numpy_helper.from_array(scales, scale))
        scaled.append(helper.make_node("Cast", [stored], [whole], to=TensorProto.FLOAT))
        scaled.append(helper.make_node("Mul", [whole, scale], [name]))
    model.graph.initializer.extend(all_scales)
    nodes = list(model.graph.node)
    del model.graph.node[:]
    model.graph.node.extend(scaled + nodes)
    del model.graph.value_info[:]
    del model.metadata_props[:]
    for node in model.graph.node:
        node.doc_string = ""
        del node.metadata_props[:]
    onnx.checker.check_model(model, full_check=True)
    return model


def append_suppression(model: onnx.ModelProto, score_threshold: float = 0.05) -> onnx.ModelProto:
    """Per-class non-maximum suppression; the output becomes `detections [1, N, 6]`."""
    graph = model.graph
    constants = {
        "nms_most": np.array([MAX_DETECTIONS_PER_CLASS], np.int64),
        "nms_iou": np.array([0.5], np.float32),
        "nms_score": np.array([score_threshold], np.float32),
        "axis_1": np.array([1], np.int64),
        "box_column": np.array([2], np.int64),
        "class_column": np.array([1], np.int64),
        "squeeze_0": np.array([0], np.int64),
    }
    graph.initializer.extend(numpy_helper.from_array(v, k) for k, v in constants.items())
    node = helper.make_node
    graph.node.extend(
        [
            node("NonMaxSuppression", ["boxes", "scores", "nms_most", "nms_iou", "nms_score"], ["selected"]),
            node("Gather", ["selected", "box_column"], ["box_index_2d"], axis=1),
            node("Squeeze", ["box_index_2d", "axis_1"], ["box_index"]),
            node("Squeeze", ["boxes", "squeeze_0"], ["boxes_2d"]),
            node("Gather", ["boxes_2d", "box_index"], ["kept_boxes"], axis=0),
            node("GatherND", ["scores", "selected"], ["kept_scores"]),
            node("Unsqueeze", ["kept_scores", "axis_1"], ["kept_scores_2d"]),
            node("Gather", ["selected", "class_column"], ["class_2d"], axis=1),
            node("Cast", ["class_2d"], ["kept_classes"], to=TensorProto.FLOAT),
            node("Concat", ["kept_boxes", "kept_scores_2d", "kept_classes"], ["rows"], axis=1),
            node("Unsqueeze", ["rows", "squeeze_0"], ["detections"]),
        ]
    )
    del graph.output[:]
    graph.output.append(helper.make_tensor_value_info("detections", TensorProto.FLOAT, [1, "found", 6]))
    onnx.checker.check_model(model, full_check=True)
    return model


def covariance_scale(predict: Predictor, views: list[View], truth: np.ndarray) -> np.ndarray:
    """One factor per keypoint, so that the mean squared Mahalanobis distance on held-out views is 2.

    Gross errors are left out (the solver treats them as outliers): the factor follows from the median, which for a
    chi-squared variable of 2 degrees of freedom is 2 ln 2. `truth` is `[V, symmetries, N, 2]`.
    """
    predictions = predict_views(predict, views)
    squared = []
    for prediction, alike in zip(predictions, truth):
        errors = prediction.keypoints - alike
        error = errors[np.linalg.norm(errors, axis=-1).mean(-1).argmin()][..., None]
        covariance = prediction.covariances + 0.3**2 * np.eye(2)  # the solver's floor
        squared.append((np.swapaxes(error, 1, 2) @ np.linalg.inv(covariance) @ error)[:, 0, 0])
    return np.median(np.array(squared), axis=0) / (2 * np.log(2))


def write_parity(expect: Callable[[np.ndarray], np.ndarray], network: Path, views: list[View]) -> None:
    """`parity.png`, crops one below the other, and `parity.json`, where `expect` sees their keypoints: whoever runs the
    exported network elsewhere can compare. Refuses a network that differs here already."""
    net = predictor(network)
    views = views[:: max(1, len(views) // PARITY_CROPS)][:PARITY_CROPS]
    cut = [first_crop(view, net.size)[0][None] for view in views]
    noise = np.random.default_rng(1).integers(0, 256, (2, net.size, net.size, 3), np.uint8)
    crops = np.concatenate(cut) if cut else noise
    keypoints = expect(crops)
    apart = np.abs(net.run(crops)[0] - keypoints).max()
    if apart > PARITY_TOLERANCE_PX:
        raise RuntimeError(f"{network}: differs by {apart:.3f} px from what was exported")
    Image.fromarray(crops.reshape(-1, net.size, 3)).save(network.with_name("parity.png"), optimize=True)
    expected = {"keypoints_px": keypoints.round(4).tolist(), "tolerance_px": PARITY_TOLERANCE_PX}
    network.with_name("parity.json").write_text(json.dumps(expected, indent=1) + "\n")


def write_manifest(path: Path, manifest: dict) -> None:
    path.write_text(json.dumps(manifest, indent=2) + "\n")


def export_keypoints(
    net: KeypointNet,
    views: Views,
    out: Path,
    identity: dict,
    training: dict,
    symmetries_discrete: list[list[float]] | None = None,
) -> None:
    """Writes `keypoints.onnx`, `object.json` and the parity files; refuses an export that differs from PyTorch."""
    out.mkdir(parents=True, exist_ok=True)
    module = KeypointExport(net, unfamiliarity(net, views))
    fold_batch_norms(module)
    round_to_bytes(module)
    example = torch.randint(0, 256, (2, net.input_size, net.input_size, 3), dtype=torch.uint8)
    path = out / "keypoints.onnx"
    onnx.save(to_onnx(module, example, list(KEYPOINT_OUTPUTS), dynamic_batch=True), path)
    registration = views.registration
    judging = [views.all[index] for index in views.judging]
    with torch.no_grad():
        write_parity(lambda crops: module(torch.from_numpy(crops))[0].numpy(), path, judging)
    scale = covariance_scale(predictor(path, views.heights), judging, views.targets(views.judging))
    manifest = {
        **identity,
        "model_sha256": sha256(path),
        "virtual_keypoints_m": registration.keypoints.round(9).tolist(),
        "diameter_m": round(registration.size_m, 5),
        **({"symmetries_discrete": symmetries_discrete} if symmetries_discrete else {}),
        "crop_scale": CROP_SCALE,
        "crop_ensemble": [asdict(variant) for variant in CROP_ENSEMBLE],
        **({"second_look": {"zoom": ZOOM, "up": views.up.round(9).tolist()}} if views.up is not None else {}),
        "input": {"layout": "nhwc", "dtype": "uint8", "size": net.input_size},
        "output": {"kind": "keypoints"},
        "covariance_scale": scale.round(4).tolist(),
        "training": training,
    }
    write_manifest(out / "object.json", manifest)


def export_detector(model, labels: list[str], out: Path, training: dict, score_threshold: float = 0.4) -> None:
    """Writes `detector.onnx` and `detector.json`."""
    out.mkdir(parents=True, exist_ok=True)
    module = DetectorExport(model)
    fold_batch_norms(module)
    round_to_bytes(module)
    example = torch.randint(0, 256, (1, detector.HEIGHT, detector.WIDTH, 3), dtype=torch.uint8)
    path = out / "detector.onnx"
    onnx.save(append_suppression(to_onnx(module, example, ["boxes", "scores"], dynamic_batch=False)), path)
    session(path).run(["detections"], {"image": example.numpy()})
    manifest = {
        "format": "end2end",
        "model_sha256": sha256(path),
        "input": {
            "layout": "nhwc",
            "dtype": "uint8",
            "width": detector.WIDTH,
            "height": detector.HEIGHT,
            "fill": detector.FILL,
        },
        "labels": labels,
        "score_threshold": score_threshold,
        "max_detections_per_class": MAX_DETECTIONS_PER_CLASS,
        "training": training,
    }
    write_manifest(out / "detector.json", manifest)


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
