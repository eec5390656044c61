"""The keypoint network: RGB crop in, one heatmap of logits per virtual keypoint out.

`lite` is a half-width ResNet-18 encoder with a U-Net style decoder that stops at stride 2. It follows the
paper's network (section 3.1: ResNet-18, skip connections, N heatmaps) but keeps plain strides instead of
dilation, because dilated layers at stride 8 cost four times as much on a CPU.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

INPUT_SIZE = 128
HEATMAP_STRIDE = 2


def conv_bn(channels_in: int, channels_out: int, kernel: int = 3, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(channels_out),
    )


class BasicBlock(nn.Module):
    """The two-layer residual block of ResNet-18."""

    def __init__(self, channels_in: int, channels_out: int, stride: int):
        super().__init__()
        self.conv1 = conv_bn(channels_in, channels_out, 3, stride)
        self.conv2 = conv_bn(channels_out, channels_out)
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
    """Upsamples the deepest map step by step, adding the skip connection of each resolution."""

    def __init__(self, widths: tuple[int, ...]):
        super().__init__()
        pairs = list(zip(widths[::-1], widths[-2::-1]))
        self.reduce = nn.ModuleList(conv_bn(deep, shallow, 1) for deep, shallow in pairs)
        self.merge = nn.ModuleList(conv_bn(shallow, shallow) for _, shallow in pairs)

    def forward(self, features: list[Tensor]) -> Tensor:
        x = features[-1]
        for reduce, merge, skip in zip(self.reduce, self.merge, features[-2::-1]):
            x = F.interpolate(reduce(x), size=skip.shape[-2:], mode="bilinear", align_corners=False)
            x = F.relu(merge(F.relu(x + skip)), inplace=True)
        return x


class KeypointNet(nn.Module):
    """`[B, 3, 128, 128]` floats in 0..1 -> `[B, N, 64, 64]` logits."""

    def __init__(self, keypoints: int):
        super().__init__()
        self.encoder = Encoder()
        self.decoder = Decoder(self.encoder.widths)
        self.head = nn.Conv2d(self.encoder.widths[0], keypoints, 1)
        self.register_buffer("mean", torch.tensor([0.485, 0.456, 0.406]).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor([0.229, 0.224, 0.225]).view(1, 3, 1, 1))

    def forward(self, crops: Tensor) -> Tensor:
        return self.head(self.decoder(self.encoder((crops - self.mean) / self.std)))
