"""The training loop of a keypoint net."""

import copy
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from . import bop, exported, joined, metrics, optimise, pairwise, stopping
from .best import Best
from .config import KeypointConfig
from .data import DEVICE, Batches, Data, PairBatch, Pairs, Views
from .heatmap import Decode
from .held_out import look
from .losses import heatmap_loss, soft_argmax
from .network import KeypointNet
from .pictures import Log, draw_curves, draw_sheet
from .registration import JOIN_DISTANCE_OF_SIZE, JOIN_ROTATION_DEG, consensus, join
from .validate import Prediction, Predictor, predict_views, score, solve_pose

VALIDATE_EVERY = 1000
CHECKPOINT_EVERY = 250
FIRST_SHEET = 100
FEW_HELD_OUT = 40
"""So many views are looked at with every checkpoint."""
ADOPTING_VIEWS = 100
"""In which an exported net says where its keypoints are on the object."""
SETTLE_BATCHES = 16
"""That tell what the layers of an exported net see."""
COMPARISONS = 10
"""Of a training's nets on held-out views, if there are that many within its limits."""
COMPARE_EVERY = 50, 1000
LOSSES = ("component", "pairwise", "registration")
WEIGHTS_GROW = 0.1, 0.3
"""Shares of the steps between which `distance_weight` and `scale_weight` grow. While a net does not know where its
keypoints are, these losses hold them together at the crop's centre: with the full weights from the first step on, a
cube's were 60 px off after 750 steps, and 3 px off after 630 with weights that grow."""
FIRST_DISTANCE_WEIGHT = 0.05
progress_line: int | None = None
"""Of the terminal, counted from where it is, where several trainings show their progress."""


def predictor(model: KeypointNet, heights: np.ndarray | None) -> Predictor:
    decode = Decode(model.input_size // model.stride, model.stride).to(DEVICE)

    @torch.no_grad()
    def predict(crops: np.ndarray):
        model.eval()
        images = torch.from_numpy(crops.copy()).to(DEVICE).permute(0, 3, 1, 2).float() / 255
        return tuple(output.cpu().numpy() for output in decode(model(images)))

    return Predictor(model.input_size, predict, heights)


def start_from(model: KeypointNet, weights: dict[str, Tensor]) -> None:
    """Takes a trained net's weights. Of a head for another number of keypoints it takes the first ones: the solids'
    vertices come in a fixed order, and a rhombic dodecahedron's first eight are the cube's."""
    own = model.state_dict()
    if differing := sorted(own.keys() ^ weights.keys()):
        raise ValueError(
            f"--init: that checkpoint is of another network than `network` says: {differing[0]} and "
            f"{len(differing) - 1} more weights are in one of them alone"
        )
    for name, value in weights.items():
        if own[name].shape[1:] == value.shape[1:] and own[name].shape != value.shape:
            count = min(len(own[name]), len(value))
            weights[name] = torch.cat([value[:count], own[name][count:]])
        elif own[name].shape != value.shape:
            raise ValueError(
                f"--init: that checkpoint's {name} is {tuple(value.shape)}, expected {tuple(own[name].shape)}"
            )
    model.load_state_dict(weights)


class Trainer(optimise.Run):
    """A keypoint net's training."""

    def __init__(self, config: KeypointConfig, keypoints: np.ndarray, init: Path | None):
        torch.manual_seed(config.seed)
        self.config = config
        self.keypoints = torch.from_numpy(keypoints).float().to(DEVICE)
        model = KeypointNet(len(keypoints), config.network).to(DEVICE, memory_format=torch.channels_last)
        if config.frozen_statistics and not hasattr(model.design, "encoder"):
            raise ValueError(f"frozen_statistics: the network {config.network!r} has no encoder to hold them in")
        self.unsettled = init is not None and init.suffix == ".onnx"
        if self.unsettled:
            start_from(model, exported.unfold(model, exported.read_weights(init)))
        elif init is not None:
            start_from(model, optimise.load(init, DEVICE, ["average"])["average"])
        elif model.design.pretrained:
            model.design.encoder.load_imagenet()
        elif config.frozen or config.frozen_statistics:
            raise ValueError("frozen: only a training that starts from a checkpoint (--init) can hold parts of it")
        optimise.freeze(model.design, config.frozen, config.frozen_statistics)
        slow = model.design.encoder if model.design.pretrained else None
        super().__init__(model, config.learning_rate, config.steps, slow, config.encoder_rate)

    def settle(self, batches: Iterator) -> None:
        """Once the crops are there: what an exported net's layers see of them."""
        first = islice(batches, SETTLE_BATCHES)
        images = (batch.images if isinstance(batch, PairBatch) else batch[0] for batch in first)
        exported.settle(self.model, (crops.to(DEVICE).float() / 255 for crops in images))
        self.average.load_state_dict(self.model.state_dict())

    def forward(self, images: Tensor) -> Tensor:
        self.model.train()
        if self.config.frozen_statistics:
            self.model.design.encoder.eval()  # which tells nothing but batch normalisation
        images = images.to(DEVICE, non_blocking=True).float() / 255
        with optimise.mixed_precision(DEVICE, depthwise=self.model.design.depthwise):
            return self.model(images).float()

    def component_step(self, batch: tuple[Tensor, Tensor]) -> float:
        """Supervised by the projected keypoints."""
        images, keypoints = batch
        logits = self.forward(images)
        return self.descend(heatmap_loss(logits, keypoints.to(DEVICE), self.model.input_size, *self.weights()))

    def weights(self) -> tuple[float, float]:
        """Of the keypoints' distance and of their common scale, at this step."""
        first, last = WEIGHTS_GROW
        grown = min(1.0, max(0.0, (self.step / self.steps - first) / (last - first)))
        start = min(FIRST_DISTANCE_WEIGHT, self.config.distance_weight)
        return start + grown * (self.config.distance_weight - start), grown * self.config.scale_weight

    def pairwise_step(self, batch: PairBatch) -> float:
        """Supervised by the other view of a pair, as in the paper."""
        batch = batch.to(DEVICE)
        pixels = soft_argmax(self.forward(batch.images), self.model.input_size)
        linear, shift = batch.normalised_from_crop[..., :2], batch.normalised_from_crop[:, None, :, 2]
        first, second = (pixels @ linear.transpose(-1, -2) + shift).chunk(2)
        consistency = self.config.loss == "pairwise"
        return self.descend(pairwise.pairwise_loss(self.keypoints, first, second, batch.second_from_first, consistency))


class Trained(NamedTuple):
    net: KeypointNet
    views: Views
    scores: dict[str, float]  # of the net
    step: int  # that the net is of
    last: int  # step of the training


def use_threads(count: int | None) -> None:
    if count is not None:
        torch.set_num_threads(count)
        cv2.setNumThreads(count)


def train(config: KeypointConfig, root: Path, out: Path, init: Path | None = None, workers: int = 0) -> Trained:
    """Trains (or goes on training) one object's net; `out` gets checkpoint.pt, best.pt, log.csv, curves.png and
    sheet.png. The net that comes back is the best one by held-out views, if any tell.

    `workers` processes prepare batches; with none the training does so itself.
    """
    out.mkdir(parents=True, exist_ok=True)
    if config.loss not in LOSSES:
        raise ValueError(f"loss {config.loss!r}: choose one of {', '.join(LOSSES)}")
    optimise.keep_memory()
    views = Views(config, root)
    adopted = out / "adopted.json"
    before = adopted if adopted.exists() or init is None else init.with_name("adopted.json")
    if before.exists():
        joined.read_adopted(before, config, views)
        joined.write_adopted(adopted, views)
    elif init is not None and init.suffix == ".onnx":
        adopt(config, views, init)
        joined.write_adopted(adopted, views)
    # Before the crops are cut: what cannot be trained is said at once.
    trainer = Trainer(config, views.registration.keypoints, init)
    checkpoint = out / "checkpoint.pt"
    resumed = checkpoint.exists()
    joined_before = out / "joined.json"
    if resumed:
        trainer.resume(checkpoint, DEVICE)
        joined.read(joined_before, views)
    elif init is not None and config.loss == "component" and join_components(config, views, trainer.average):
        joined.write(joined_before, views)
    if not config.stops_itself:
        trainer.cooling = None
    best = Best(out / "best.pt", resumed)
    data = Data(config, root, views)
    validator = Validator(config, root, views)
    source, step = (
        (data, trainer.component_step) if config.loss == "component" else (Pairs(config, views), trainer.pairwise_step)
    )
    batches = load(source, data, config, trainer, workers)
    if trainer.unsettled and not resumed:
        trainer.settle(load(source, data, config, trainer, workers))
    log = Log(out / "log.csv")
    losses, clock = [], Clock(trainer)
    progress = {"total": trainer.end, "initial": trainer.step, "desc": config.name, "position": progress_line}
    with tqdm(mininterval=10, **progress) as bar:
        while trainer.step < trainer.end:
            losses.append(step(next(batches)))
            bar.update()
            due = lambda every: trainer.step % every == 0 or trainer.step == trainer.end  # noqa: E731
            comparing = due(compare_every(config.steps))
            if trainer.step == FIRST_SHEET:
                draw_progress(views, trainer.average, out)
            if not (due(CHECKPOINT_EVERY) or comparing):
                continue
            row = {"step": trainer.step, "seconds": round(clock.seconds), "loss": round(np.mean(losses), 4)}
            words = [f"loss {row['loss']:.3f}"]
            told = None
            if comparing or len(views.held_out) <= FEW_HELD_OUT:
                told = look(predictor(trainer.average, views.heights), views)
            if told is not None:
                row |= told.as_row()
                words.append(told.in_words())
                if comparing:
                    best.offer(trainer.average, trainer.step, told.standing)
            trainer.save(checkpoint)
            bar.set_postfix_str(", ".join(words))
            bar.write("; ".join([f"step {trainer.step} of {trainer.end}: {words[0]}", *words[1:], clock.left()]))
            draw_progress(views, trainer.average, out)
            if due(VALIDATE_EVERY):
                scores = validator(trainer.average)
                row |= {key: round(value, 3) for key, value in scores.items()}
                if scores:
                    bar.write(f"step {trainer.step}: " + ", ".join(f"{k} {v:.1f}" for k, v in scores.items()))
                before = len(views.held_out)
                if count := join_components(config, views, trainer.average):
                    joined.write(joined_before, views)
                    data.add_placed()
                    batches = load(source, data, config, trainer, workers)
                    bar.write(f"step {trainer.step}: {count} more components placed")
                if len(views.held_out) > before:
                    best.forget()
            log.write(row)
            draw_curves(log, out / "curves.png")
            losses = []
            if config.stops_itself and trainer.cooling is None:
                trainer.cooling = stopping.cooling(log.read(), trainer.step, config.steps)
                if trainer.cooling is not None:
                    bar.total = trainer.end
                    batches = load(source, data, config, trainer, workers)
                    bar.write(f"step {trainer.step}: held-out photos gain no more; cooling down to step {trainer.end}")
    net = copy.deepcopy(trainer.average)
    best_step = best.restore(net)
    return Trained(net, views, validator(net), trainer.step if best_step is None else best_step, trainer.step)


class Clock:
    """How long a training has run, and how long it will."""

    def __init__(self, trainer: Trainer):
        self.trainer, self.first, self.started = trainer, trainer.step, time.time()

    @property
    def seconds(self) -> float:
        return time.time() - self.started

    def left(self) -> str:
        trainer = self.trainer
        minutes = self.seconds / (trainer.step - self.first) * (trainer.end - trainer.step) / 60
        if trainer.step == trainer.end:
            return f"done after {self.seconds / 60:.0f} min"
        return f"{minutes // 60:.0f} h {minutes % 60:.0f} min left" if minutes >= 60 else f"{minutes:.0f} min left"


def adopt(config: KeypointConfig, views: Views, network: Path) -> None:
    """Leaves the keypoints of an exported net where they are on the object."""
    manifest = bop.read_json(network.with_name("object.json"))
    keypoints = np.array(manifest["virtual_keypoints_m"])
    if keypoints.shape != views.registration.keypoints.shape:
        raise ValueError(
            f"--init {network}: it has {len(keypoints)} keypoints, and keypoint_shape {config.keypoint_shape!r} "
            f"{len(views.registration.keypoints)}"
        )
    heights = keypoints @ manifest["second_look"]["up"] if "second_look" in manifest else None
    members = [index for index in views.registration.components[0].views if index < views.photoreal_count]
    chosen = members[:: max(1, len(members) // ADOPTING_VIEWS)]
    predictions = predict_views(exported.predictor(network, heights), [views.all[index] for index in chosen])
    views.adopt(config, keypoints, {i: solve_pose(keypoints, found) for i, found in zip(chosen, predictions)})


def compare_every(steps: int) -> int:
    least, most = COMPARE_EVERY
    return min(most, max(least, steps // COMPARISONS))


def draw_progress(views: Views, model: KeypointNet, out: Path) -> None:
    """The keypoints on held-out views, `sheet.png`."""
    if views.held_out:
        held_out = [views.all[index] for index in views.held_out]
        draw_sheet(predictor(model, views.heights), held_out, views.targets(views.held_out), out / "sheet.png")


def load(source: Data | Pairs, data: Data, config: KeypointConfig, trainer: Trainer, workers: int):
    """Batches from the trainer's step to its end."""
    cooling = trainer.cooling

    def strength(step: int) -> float:
        return config.augmentation * augmentation_fade(step, config.steps, config.final_augmentation, cooling)

    batches = Batches(source, data, config, range(trainer.step, trainer.end), strength)
    # Forked, so that workers share the patches and need no copy of `strength`.
    context = "fork" if workers else None
    return iter(
        torch.utils.data.DataLoader(batches, batch_size=None, num_workers=workers, multiprocessing_context=context)
    )


def join_components(config: KeypointConfig, views: Views, model: KeypointNet) -> int:
    """Lets the net place components that geometry alone cannot; returns how many joined."""
    waiting = [index for index in range(len(views.all)) if index not in views.registration.placed]
    if not waiting:
        return 0
    predictions = predict_views(predictor(model, views.heights), [views.all[index] for index in waiting])
    poses = [solve_pose(views.registration.keypoints, prediction) for prediction in predictions]
    count = join(views.registration, dict(zip(waiting, poses)))
    views.hold_out_of([index for index in waiting if index in views.registration.placed], config)
    return count


def augmentation_fade(step: int, steps: int, final: float, cooling: tuple[int, int] | None = None) -> float:
    """1 for half of the training, then falling to `final`; where it ends sooner, within half of that."""
    if cooling is not None and step >= cooling[0]:
        first, last = cooling
        start = augmentation_fade(first, steps, final)
        return start - (start - final) * min(1.0, 2 * (step - first) / (last - first))
    return 1 - (1 - final) * max(0.0, min(1.0, (step / steps - 0.5) / 0.3))


class Validator:
    """Scores a model on the validation split, if there is one and object poses to score against."""

    def __init__(self, config: KeypointConfig, root: Path, views: Views):
        self.registration, self.keypoints_from_object = views.registration, views.keypoints_from_object
        self.heights = views.heights
        self.views = []
        if config.validation and self.keypoints_from_object is not None:
            self.views = bop.read_views(root / config.validation, config.obj_id, min_visible=0.7)
        if self.views:
            models = root / config.models
            info = bop.read_json(models / "models_info.json")[str(config.obj_id)]
            self.model = metrics.load_model(models / f"obj_{config.obj_id:06d}.ply", info)

    def __call__(self, model: KeypointNet) -> dict[str, float]:
        return self.score(predictor(model, self.heights))

    def score(self, net: Predictor) -> dict[str, float]:
        if not self.views:
            return {}
        predictions = predict_views(net, self.views)
        offset = self.keypoints_from_object if self.heights is not None else self.voted_offset(predictions)
        return score(self.model, self.registration.keypoints, offset, predictions)

    def voted_offset(self, predictions: list[Prediction]) -> np.ndarray:
        """With the paper's losses the net chooses the keypoints' frame: what most views agree on."""
        poses = [solve_pose(self.registration.keypoints, prediction) for prediction in predictions]
        votes = [
            np.linalg.inv(pose) @ prediction.view.camera_from_object
            for pose, prediction in zip(poses, predictions)
            if pose is not None
        ]
        if not votes:
            return np.eye(4)
        return consensus(np.stack(votes), JOIN_ROTATION_DEG, JOIN_DISTANCE_OF_SIZE * self.registration.size_m)
