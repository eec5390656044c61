"""The detector: torchvision's FCOS on a keypoint net's encoder, trained on the same BOP images as the keypoint nets.

Input is the image fitted into 448 x 352 at the top left (`letterbox`), as the service does it. An encoder from ImageNet
keeps its first stages and its statistics, as torchvision's detectors do: batches are small, and a step takes a quarter
less time.
"""

import csv
import time
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torchvision.models.detection import FCOS
from torchvision.models.detection.anchor_utils import AnchorGenerator
from torchvision.models.detection.fcos import FCOSHead
from torchvision.ops import box_iou
from tqdm import tqdm

from . import bop, optimise
from .camera import vary_camera
from .colour import vary_colour
from .config import DetectorConfig, splits
from .data import DEVICE, read_backgrounds
from .network import Lite, conv_bn, design
from .occlusion import CAMOUFLAGE_SHARE, camouflage

WIDTH, HEIGHT = 448, 352  # multiples of the deepest stride, so that training pads nothing
FILL = 114
FEATURES = 64
STRIDES = (8, 16)
CHECKPOINT_EVERY = 250
VALIDATE_EVERY = 1000
MIN_VISIBLE = 0.2
MIN_BOX_PX = 6  # in the network's input
MIN_BACKGROUND_PX = 128
PASTED_SHARE = 0.4
"""Of the images: shown on another background."""
EMPTY_SHARE = 0.15
"""Of the images: backgrounds, without any object."""
COLOUR_STRENGTH = 0.7
FROZEN = "stem", "stages.0", "stages.1"
"""Of an encoder from ImageNet."""
ENCODER_RATE = 0.3
"""Of the learning rate, for an encoder from ImageNet."""


class Backbone(nn.Module):
    """The encoder of a keypoint net's `design` with a feature pyramid at strides 8 and 16."""

    def __init__(self, design: type[Lite]):
        super().__init__()
        self.out_channels = FEATURES
        self.encoder = design.make_encoder()
        _, _, *widths = self.encoder.widths
        self.lateral = nn.ModuleList(conv_bn(width, FEATURES, 1) for width in widths)
        self.smooth = nn.ModuleList(conv_bn(FEATURES, FEATURES) for _ in STRIDES)

    def forward(self, images: Tensor) -> OrderedDict[str, Tensor]:
        levels = [lateral(f) for lateral, f in zip(self.lateral, self.encoder(images)[2:])]
        for i in range(len(levels) - 2, -1, -1):
            size = levels[i].shape[-2:]
            levels[i] = levels[i] + F.interpolate(levels[i + 1], size=size, mode="nearest")
        smoothed = (F.relu(smooth(F.relu(level))) for smooth, level in zip(self.smooth, levels))
        return OrderedDict((str(i), level) for i, level in enumerate(smoothed))


def encoder_of(network: str) -> type[Lite]:
    """The design of a keypoint net whose encoder a detector can have."""
    kind = design(network)
    if not issubclass(kind, Lite):
        raise ValueError(f"network {network!r}: a detector has the encoder of lite0 or lite")
    return kind


def build(classes: int, network: str) -> FCOS:
    kind = encoder_of(network)
    return FCOS(
        Backbone(kind),
        classes,
        image_mean=list(kind.normalisation.mean),
        image_std=list(kind.normalisation.std),
        min_size=HEIGHT,
        max_size=WIDTH,
        anchor_generator=AnchorGenerator(tuple((s,) for s in STRIDES), ((1.0,),) * len(STRIDES)),
        head=FCOSHead(FEATURES, 1, classes, num_convs=2),
        score_thresh=0.05,
        nms_thresh=0.5,
        detections_per_img=32,
        topk_candidates=300,
    )


def letterbox(image: np.ndarray) -> tuple[np.ndarray, float]:
    """The image fitted at the top left, and its scale."""
    scale = min(WIDTH / image.shape[1], HEIGHT / image.shape[0])
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    canvas = np.full((HEIGHT, WIDTH, *image.shape[2:]), FILL if image.ndim == 3 else 0, np.uint8)
    canvas[: size[1], : size[0]] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return canvas, scale


@dataclass
class Sample:
    image: np.ndarray  # [HEIGHT, WIDTH, 3]
    objects: np.ndarray  # [HEIGHT, WIDTH] 255 where any object is visible
    boxes: np.ndarray  # [N, 4] x1, y1, x2, y2 edges
    labels: np.ndarray  # [N]
    visible: np.ndarray  # [N] fractions


def read_samples(split: Path, obj_ids: list[int]) -> list[Sample]:
    images: dict[Path, list[tuple[int, bop.View]]] = {}
    for label, obj_id in enumerate(obj_ids):
        for view in bop.read_views(split, obj_id, MIN_VISIBLE):
            images.setdefault(view.image_path, []).append((label, view))
    samples = []
    for path, views in tqdm(sorted(images.items()), desc=f"reading {split.name}", mininterval=5):
        image, scale = letterbox(bop.read_rgb(path))
        objects = np.zeros((HEIGHT, WIDTH), np.uint8)
        for _, view in views:
            mask = bop.read_mask(view)
            if mask is not None:
                objects = np.maximum(objects, letterbox(mask)[0])
        boxes = np.array([[x, y, x + w, y + h] for _, view in views for x, y, w, h in [view.box]]) * scale
        labels, visible = zip(*((label, view.visible_fraction) for label, view in views))
        samples.append(Sample(image, objects, boxes, np.array(labels), np.array(visible)))
    return samples


def augment(sample: Sample, backgrounds: list[np.ndarray], rng: np.random.Generator) -> Sample:
    image = sample.image
    if backgrounds and sample.objects.any() and rng.random() < PASTED_SHARE:
        photo = backgrounds[rng.integers(len(backgrounds))]
        own = colours_of_one(sample, rng) if rng.random() < CAMOUFLAGE_SHARE else []
        background = camouflage(own, (HEIGHT, WIDTH), rng) if len(own) else cv2.resize(photo, (WIDTH, HEIGHT))
        mask = sample.objects[..., None].astype(np.float32) / 255
        image = (image * mask + background * (1 - mask)).astype(np.uint8)
    scale = np.exp(rng.uniform(np.log(0.6), np.log(1.7)))
    centre = np.array([WIDTH, HEIGHT]) / 2
    shift = centre - scale * (centre + rng.uniform(-0.15, 0.15, 2) * [WIDTH, HEIGHT])
    # The affine maps pixel centres; boxes are edges, half a pixel away.
    affine = np.array([[scale, 0, shift[0] + (scale - 1) / 2], [0, scale, shift[1] + (scale - 1) / 2]])
    border = rng.integers(0, 256, 3).tolist()
    image = cv2.warpAffine(image, affine, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR, borderValue=border)
    full = sample.boxes.reshape(-1, 2, 2) * scale + shift
    boxes = np.clip(full, 0, [WIDTH, HEIGHT]).reshape(-1, 4)
    area = lambda b: np.prod(b.reshape(-1, 2, 2)[:, 1] - b.reshape(-1, 2, 2)[:, 0], axis=1)  # noqa: E731
    sides = (boxes[:, 2:] - boxes[:, :2]).min(axis=1)
    keep = (area(boxes) > 0.35 * area(full.reshape(-1, 4))) & (sides >= MIN_BOX_PX)
    if rng.random() < 0.5:
        # A mirrored object is another object to its keypoint net, but takes the same place.
        image = image[:, ::-1]
        boxes[:, [0, 2]] = WIDTH - boxes[:, [2, 0]]
    image = vary_camera(vary_colour(image, rng, COLOUR_STRENGTH), rng, COLOUR_STRENGTH)
    return Sample(image, sample.objects, boxes[keep], sample.labels[keep], sample.visible[keep])


def empty(photo: np.ndarray) -> Sample:
    """A background with no object in it."""
    nothing = np.zeros((HEIGHT, WIDTH), np.uint8)
    return Sample(cv2.resize(photo, (WIDTH, HEIGHT)), nothing, np.zeros((0, 4)), np.zeros(0, int), np.zeros(0))


def colours_of_one(sample: Sample, rng: np.random.Generator) -> np.ndarray:
    """The pixels `[P, 3]` of one of the objects, and what covers it within its box."""
    x1, y1, x2, y2 = sample.boxes[rng.integers(len(sample.boxes))].round().astype(int)
    return sample.image[y1:y2, x1:x2][sample.objects[y1:y2, x1:x2] > 127]


def to_tensor(images: list[np.ndarray]) -> Tensor:
    return torch.from_numpy(np.stack(images)).to(DEVICE).permute(0, 3, 1, 2).float() / 255


class Trainer(optimise.Run):
    """The detector's training."""

    def __init__(self, config: DetectorConfig, encoder: Path | None):
        torch.manual_seed(config.seed)
        model = build(len(config.labels), config.network).to(DEVICE, memory_format=torch.channels_last)
        own = model.backbone.encoder
        if encoder is not None:
            state = optimise.load(encoder, DEVICE, ["average"])["average"]
            prefix = "design.encoder."
            weights = {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}
            try:
                own.load_state_dict(weights)
            except RuntimeError:
                raise ValueError(
                    f'{encoder}: not a checkpoint of a keypoint net with network = "{config.network}"'
                ) from None
        self.kind = encoder_of(config.network)
        if self.kind.pretrained:
            if encoder is None:
                own.load_imagenet()
            optimise.freeze(own, FROZEN, normalisation=True)
        slow = own if self.kind.pretrained else None
        super().__init__(model, config.learning_rate, config.steps, slow, ENCODER_RATE)

    def train_step(self, samples: list[Sample]) -> float:
        self.model.train()
        if self.kind.pretrained:
            self.model.backbone.encoder.eval()  # which tells nothing but batch normalisation
        targets = [
            {
                "boxes": torch.from_numpy(sample.boxes).float().view(-1, 4).to(DEVICE),
                "labels": torch.from_numpy(sample.labels).long().to(DEVICE),
            }
            for sample in samples
        ]
        with optimise.mixed_precision(DEVICE, self.kind.depthwise):
            losses = self.model(list(to_tensor([s.image for s in samples])), targets)
        loss = sum(losses.values())
        return self.descend(loss)


def draw(
    pools: list[list[Sample]], backgrounds: list[np.ndarray], count: int, rng: np.random.Generator
) -> list[Sample]:
    """A batch, as many of each pool."""
    batch = []
    for i in range(count):
        pool = pools[i % len(pools)]
        sample = pool[rng.integers(len(pool))]
        if backgrounds and rng.random() < EMPTY_SHARE:
            sample = empty(backgrounds[rng.integers(len(backgrounds))])
        batch.append(augment(sample, backgrounds, rng))
    return batch


@torch.no_grad()
def recall(model: FCOS, samples: list[Sample], threshold: float = 0.4) -> dict[str, float]:
    """Share of boxes found at IoU 0.5 with the right label, of all and of those that are half visible, and false
    detections an image."""
    model.eval()
    false = 0
    overlaps, visible = [], []
    for sample in samples:
        detections = model(list(to_tensor([sample.image])))[0]
        keep = detections["scores"] > threshold
        boxes, labels = detections["boxes"][keep].cpu(), detections["labels"][keep].cpu()
        truth = torch.from_numpy(sample.boxes).float()
        overlap = box_iou(truth, boxes) * (torch.from_numpy(sample.labels)[:, None] == labels[None])
        best = overlap.max(dim=1).values if len(boxes) else torch.zeros(len(truth))
        overlaps += best.tolist()
        visible += sample.visible.tolist()
        false += int((overlap.max(dim=0).values < 0.5).sum()) if len(boxes) else 0
    overlaps, half = np.array(overlaps), np.array(visible) >= 0.5
    found = overlaps > 0.5
    return {
        "recall_percent": 100 * float(found.mean()),
        "recall_half_visible_percent": 100 * float(found[half].mean()) if half.any() else 0.0,
        "false_per_image": false / len(samples),
        "mean_iou": float(overlaps[found].mean()) if found.any() else 0.0,
    }


def train(config: DetectorConfig, root: Path, out: Path, encoder: Path | None = None) -> FCOS:
    """Trains (or goes on training); `encoder` is a keypoint net's checkpoint to start from."""
    out.mkdir(parents=True, exist_ok=True)
    optimise.keep_memory()
    trainer = Trainer(config, encoder)
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        trainer.resume(checkpoint, DEVICE)
    pools = [
        [sample for split in splits(setting) for sample in read_samples(root / split, config.obj_ids)]
        for setting in (config.photoreal, config.rasterised)
    ]
    pools = [pool for pool in pools if pool]
    validation = read_samples(root / config.validation, config.obj_ids) if config.validation else []
    backgrounds = read_backgrounds(root / config.backgrounds, MIN_BACKGROUND_PX) if config.backgrounds else []
    rng = np.random.default_rng([config.seed, trainer.step])
    losses, started = [], time.time()
    with (
        (out / "log.csv").open("a", newline="") as log_file,
        tqdm(total=config.steps, initial=trainer.step, desc="detector", mininterval=10) as bar,
    ):
        log = csv.writer(log_file)
        while trainer.step < config.steps:
            losses.append(trainer.train_step(draw(pools, backgrounds, config.batch, rng)))
            bar.update()
            if trainer.step % CHECKPOINT_EVERY == 0 or trainer.step == config.steps:
                trainer.save(checkpoint)
                validate = validation and trainer.step % VALIDATE_EVERY == 0
                scores = recall(trainer.average, validation) if validate else {}
                log.writerow([trainer.step, f"{time.time() - started:.0f}", f"{np.mean(losses):.4f}", scores])
                log_file.flush()
                bar.set_postfix(loss=f"{np.mean(losses):.3f}")
                if scores:
                    bar.write(f"step {trainer.step}: " + ", ".join(f"{k} {v:.2f}" for k, v in scores.items()))
                losses = []
    return trainer.average
