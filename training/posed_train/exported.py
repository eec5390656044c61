"""Networks that were exported: to run them, and for a training that goes on from one.

The export folds batch normalisation into the convolutions, and training wants it back: with the mean and the spread
that each layer sees, so that the net says what it said.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from google.protobuf.message import DecodeError
from onnx import numpy_helper
from torch import Tensor, nn

from .bop import DatasetError
from .validate import Predictor

PREFIX = "net."
STORED_AS_INTEGERS = [
    ("_integers", "_scale"),  # export.store_as_bytes
    ("_quantized", "_scale"),  # quantize.quantize_network: weights
    ("_quantized", "_quantized_scale"),  # and biases
]
"""Suffixes of integers, and of the scale of each output channel."""


def session(path: Path) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])


def predictor(path: Path, heights: np.ndarray | None = None) -> Predictor:
    """The exported keypoint net, as `validate` wants it."""
    net = session(path)
    size = net.get_inputs()[0].shape[1]
    run = lambda crops: tuple(net.run(["keypoints", "covariances", "peaks"], {"image": crops}))  # noqa: E731
    return Predictor(size, run, heights)


def read_weights(path: Path) -> dict[str, Tensor]:
    """The weights of an exported keypoint net, by their names in `KeypointNet`."""
    try:
        stored = {weight.name: numpy_helper.to_array(weight) for weight in onnx.load(path).graph.initializer}
    except (DecodeError, ValueError) as error:
        raise DatasetError(f"--init {path}: not an ONNX file that posed-train exported ({error})") from None
    weights = {}
    for name, value in stored.items():
        if not name.startswith(PREFIX) or name.endswith(("_scale", "_zero_point")):
            continue
        for integers, scale in STORED_AS_INTEGERS:
            if name.endswith(integers) and f"{name.removesuffix(integers)}{scale}" in stored:
                name = name.removesuffix(integers)
                value = value * stored[f"{name}{scale}"].reshape(-1, *[1] * (value.ndim - 1))
        weights[name.removeprefix(PREFIX)] = torch.tensor(value, dtype=torch.float32)
    return weights


def normalised(module: nn.Module, prefix: str = "") -> dict[str, nn.BatchNorm2d]:
    """The batch normalisation behind each convolution that has one, by the convolution's name."""
    found = {}
    for name, child in module.named_children():
        found |= normalised(child, f"{prefix}{name}.")
    if isinstance(module, nn.Sequential):
        for index in range(len(module) - 1):
            if isinstance(module[index], nn.Conv2d) and isinstance(module[index + 1], nn.BatchNorm2d):
                found[f"{prefix}{index}"] = module[index + 1]
    return found


def unfold(model: nn.Module, weights: dict[str, Tensor]) -> dict[str, Tensor]:
    """The state of `model` with these weights, and batch normalisation that changes nothing."""
    state = model.state_dict()
    for convolution, normalisation in normalised(model).items():
        name = f"{convolution}.bias"
        if name not in weights:
            continue  # another network; whoever loads it says so
        layer = f"{convolution.rsplit('.', 1)[0]}.{int(convolution.rsplit('.', 1)[1]) + 1}"
        bias = weights.pop(name)
        weights |= {
            f"{layer}.weight": torch.ones_like(bias),
            f"{layer}.bias": bias,
            f"{layer}.running_mean": torch.zeros_like(bias),
            f"{layer}.running_var": torch.full_like(bias, 1 - normalisation.eps),
            f"{layer}.num_batches_tracked": state[f"{layer}.num_batches_tracked"],
        }
    return weights


@torch.no_grad()
def settle(model: nn.Module, batches: Iterable[Tensor]) -> None:
    """Lets batch normalisation that changes nothing normalise what it sees in these crops `[B, 3, S, S]`, 0..1, and
    changes its scale and shift so that the net stays as it is."""
    layers = list(normalised(model).values())
    sums = {layer: [torch.zeros_like(layer.bias, dtype=torch.float64) for _ in range(2)] + [0] for layer in layers}

    def observe(layer: nn.Module, inputs: tuple[Tensor]) -> None:
        values, seen = inputs[0].double(), sums[layer]
        seen[0] += values.sum((0, 2, 3))
        seen[1] += (values**2).sum((0, 2, 3))
        seen[2] += values.numel() // values.shape[1]

    hooks = [layer.register_forward_pre_hook(observe) for layer in layers]
    model.eval()
    for batch in batches:
        model(batch)
    for hook in hooks:
        hook.remove()
    for layer, (total, squares, count) in sums.items():
        mean = total / count
        variance = squares / count - mean**2
        layer.running_mean.copy_(mean)
        layer.running_var.copy_(variance)
        layer.weight.copy_((variance + layer.eps).sqrt())
        layer.bias.add_(mean.to(layer.bias))
