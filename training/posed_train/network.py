"""The keypoint networks: RGB crop in, one heatmap of logits per virtual keypoint out.

`paper` is the paper's network (section 3.1): ResNet-18 at output stride 8 by dilation, skip connections, upsampling to
full resolution, as in PVNet (Peng et al., CVPR 2019). `lite` is for CPUs: a half-width encoder with plain strides,
since dilated layers at stride 8 cost four times as much, and a decoder that stops at stride 2. `lite0` has the same
decoder behind EfficientNet-Lite0, which was trained on ImageNet: the others start from nothing.
"""

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from . import efficientnet


def conv_bn(channels_in: int, channels_out: int, kernel: int = 3, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, kernel, stride, kernel // 2 * dilation, dilation, bias=False),
        nn.BatchNorm2d(channels_out),
    )


class BasicBlock(nn.Module):
    """The two-layer residual block of ResNet-18."""

    def __init__(self, channels_in: int, channels_out: int, stride: int, dilation: int = 1):
        super().__init__()
        self.conv1 = conv_bn(channels_in, channels_out, 3, stride, dilation)
        self.conv2 = conv_bn(channels_out, channels_out, dilation=dilation)
        same = stride == 1 and channels_in == channels_out
        self.shortcut = nn.Identity() if same else conv_bn(channels_in, channels_out, 1, stride)

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu(self.conv1(x), inplace=True)
        return F.relu(self.conv2(y) + self.shortcut(x), inplace=True)


class Encoder(nn.Module):
    """Feature maps at strides 2, 4, 8 and 16 (and 32 where `widths` has a fifth entry)."""

    def __init__(self, widths: tuple[int, ...] = (24, 32, 64, 128, 256)):
        super().__init__()
        self.widths = widths
        self.stem = conv_bn(3, widths[0], 5, 2)
        self.stages = nn.ModuleList(
            nn.Sequential(BasicBlock(a, b, 2), BasicBlock(b, b, 1)) for a, b in pairwise(widths)
        )

    def forward(self, x: Tensor) -> list[Tensor]:
        features = [F.relu(self.stem(x), inplace=True)]
        for stage in self.stages:
            features.append(stage(features[-1]))
        return features


class Decoder(nn.Module):
    """Upsamples the deepest map step by step, adding the skip connection of each resolution, as it is or, `scaled`,
    brought to the same scale first."""

    def __init__(self, widths: tuple[int, ...], scaled: bool = False):
        super().__init__()
        self.skips = nn.ModuleList(conv_bn(width, width, 1) if scaled else nn.Identity() for width in widths[-2::-1])
        pairs = list(zip(widths[::-1], widths[-2::-1]))
        self.reduce = nn.ModuleList(conv_bn(deep, shallow, 1) for deep, shallow in pairs)
        self.merge = nn.ModuleList(conv_bn(shallow, shallow) for _, shallow in pairs)

    def forward(self, features: list[Tensor]) -> Tensor:
        x = features[-1]
        for reduce, merge, skip, feature in zip(self.reduce, self.merge, self.skips, features[-2::-1]):
            x = F.interpolate(reduce(x), size=feature.shape[-2:], mode="bilinear", align_corners=False)
            x = F.relu(merge(F.relu(x + skip(feature))), inplace=True)
        return x


class Normalisation(NamedTuple):
    """Of RGB in 0..1, what a network's first layer wants."""

    mean: tuple[float, float, float] = (0.485, 0.456, 0.406)
    std: tuple[float, float, float] = (0.229, 0.224, 0.225)


class Design(nn.Module):
    """A network without the normalisation of its input. `taps` gives its feature maps, the deepest one last; `heatmaps`
    makes logits of them."""

    input_size: int
    stride: int  # of the heatmaps
    normalisation = Normalisation()
    pretrained = False
    """Whether there is an `encoder` that starts from ImageNet."""
    depthwise = False
    """Whether most layers filter each channel by itself."""

    def taps(self, x: Tensor) -> list[Tensor]:
        raise NotImplementedError

    def heatmaps(self, taps: list[Tensor]) -> Tensor:
        raise NotImplementedError

    def forward(self, x: Tensor) -> Tensor:
        return self.heatmaps(self.taps(x))


class Lite(Design):
    """3.0 M parameters; 160 px in, heatmaps at stride 2."""

    input_size, stride = 160, 2

    def __init__(self, keypoints: int):
        super().__init__()
        self.encoder = self.make_encoder()
        # What ImageNet left is ten times as large as what a fresh convolution makes of it.
        self.decoder = Decoder(self.encoder.widths, scaled=self.pretrained)
        self.head = nn.Conv2d(self.encoder.widths[0], keypoints, 1)

    @staticmethod
    def make_encoder() -> nn.Module:
        return Encoder()

    def taps(self, x: Tensor) -> list[Tensor]:
        return self.encoder(x)

    def heatmaps(self, taps: list[Tensor]) -> Tensor:
        return self.head(self.decoder(taps))


class Lite0(Lite):
    """3.2 M parameters; 160 px in, heatmaps at stride 2; the encoder starts from ImageNet."""

    normalisation = Normalisation(efficientnet.MEAN, efficientnet.STD)
    pretrained = True
    depthwise = True

    @staticmethod
    def make_encoder() -> nn.Module:
        return efficientnet.Encoder()


class Lite0Large(Lite0):
    """`lite0` for a GPU: 224 px in, twice the time."""

    input_size = 224


class Paper(Design):
    """13 M parameters; 192 px in, heatmaps at full resolution."""

    input_size, stride = 192, 1

    def __init__(self, keypoints: int):
        super().__init__()
        self.stem = conv_bn(3, 64, 7, 2)
        self.layer1 = nn.Sequential(BasicBlock(64, 64, 1), BasicBlock(64, 64, 1))
        self.layer2 = nn.Sequential(BasicBlock(64, 128, 2), BasicBlock(128, 128, 1))
        self.layer3 = nn.Sequential(BasicBlock(128, 256, 1, 2), BasicBlock(256, 256, 1, 2))
        self.layer4 = nn.Sequential(BasicBlock(256, 512, 1, 4), BasicBlock(512, 512, 1, 4))
        self.neck = conv_bn(512, 256)
        self.up8, self.up4, self.up2 = conv_bn(256 + 128, 128), conv_bn(128 + 64, 64), conv_bn(64 + 64, 64)
        self.up1 = conv_bn(64 + 3, 32)
        self.head = nn.Conv2d(32, keypoints, 1)

    def taps(self, x: Tensor) -> list[Tensor]:
        at2 = F.relu(self.stem(x))
        at4 = self.layer1(F.max_pool2d(at2, 3, 2, 1))
        at8 = self.layer2(at4)
        return [x, at2, at4, at8, self.layer4(self.layer3(at8))]

    def heatmaps(self, taps: list[Tensor]) -> Tensor:
        x, at2, at4, at8, deepest = taps
        y = F.relu(self.neck(deepest))
        y = F.relu(self.up8(torch.cat([y, at8], 1)))
        for merge, skip in ((self.up4, at4), (self.up2, at2), (self.up1, x)):
            y = F.interpolate(y, size=skip.shape[-2:], mode="bilinear", align_corners=False)
            y = F.relu(merge(torch.cat([y, skip], 1)))
        return self.head(y)


DESIGNS: dict[str, type[Design]] = {"lite0": Lite0, "lite0-224": Lite0Large, "lite": Lite, "paper": Paper}


def design(name: str) -> type[Design]:
    if name not in DESIGNS:
        raise ValueError(f"network {name!r}: choose one of {', '.join(DESIGNS)}")
    return DESIGNS[name]


class KeypointNet(nn.Module):
    """`[B, 3, S, S]` floats in 0..1 -> `[B, N, S / stride, S / stride]` logits."""

    def __init__(self, keypoints: int, name: str):
        super().__init__()
        self.design = design(name)(keypoints)
        for part, value in self.design.normalisation._asdict().items():
            self.register_buffer(part, torch.tensor(value).view(1, 3, 1, 1))

    @property
    def input_size(self) -> int:
        return self.design.input_size

    @property
    def stride(self) -> int:
        return self.design.stride

    def forward(self, crops: Tensor) -> Tensor:
        return self.with_features(crops)[0]

    def with_features(self, crops: Tensor) -> tuple[Tensor, Tensor]:
        """The logits, and the mean of the deepest feature map `[B, F]`: what the crop looks like as a whole."""
        taps = self.design.taps((crops - self.mean) / self.std)
        return self.design.heatmaps(taps), taps[-1].mean((2, 3))
