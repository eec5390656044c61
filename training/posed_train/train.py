"""The training loop of a keypoint net."""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from . import bop, metrics, optimise, pairwise
from .config import KeypointConfig
from .data import DEVICE, Batches, Data, PairBatch, Pairs, Views
from .heatmap import Decode
from .losses import heatmap_loss, soft_argmax
from .network import KeypointNet
from .pictures import Log, draw_curves, draw_sheet
from .registration import JOIN_DISTANCE_OF_SIZE, JOIN_ROTATION_DEG, consensus, join
from .validate import Prediction, Predictor, predict_views, score, solve_pose

VALIDATE_EVERY = 1000
CHECKPOINT_EVERY = 250
FINAL_AUGMENTATION = 0.4
LOSSES = ("component", "pairwise", "registration")


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
    for name, value in weights.items():
        if name in own and own[name].shape[1:] == value.shape[1:] and own[name].shape != value.shape:
            count = min(len(own[name]), len(value))
            weights[name] = torch.cat([value[:count], own[name][count:]])
    model.load_state_dict(weights)


def freeze(model: KeypointNet, parts: list[str]) -> None:
    """Holds the convolutions of these parts; their normalisation still learns."""
    modules = dict(model.design.named_modules())
    for part in parts:
        if part not in modules:
            known = ", ".join(name for name in modules if name and name.count(".") <= 2)
            raise ValueError(f"frozen {part!r}: the network has no such part; it has {known}, and parts of these")
        for module in modules[part].modules():
            if isinstance(module, nn.Conv2d):
                module.requires_grad_(False)


class Trainer(optimise.Run):
    """A keypoint net's training."""

    def __init__(self, config: KeypointConfig, keypoints: np.ndarray, init: Path | None):
        torch.manual_seed(config.seed)
        self.config = config
        self.keypoints = torch.from_numpy(keypoints).float().to(DEVICE)
        model = KeypointNet(len(keypoints), config.network).to(DEVICE, memory_format=torch.channels_last)
        if init is not None:
            start_from(model, torch.load(init, map_location=DEVICE, weights_only=True)["average"])
        elif config.frozen:
            raise ValueError("frozen: only a training that starts from a checkpoint (--init) can hold parts of it")
        freeze(model, config.frozen)
        super().__init__(model, config.learning_rate, config.steps)

    def forward(self, images: Tensor) -> Tensor:
        self.model.train()
        images = images.to(DEVICE, non_blocking=True).float() / 255
        with torch.autocast(DEVICE.type, torch.bfloat16):
            return self.model(images).float()

    def component_step(self, batch: tuple[Tensor, Tensor]) -> float:
        """Supervised by the projected keypoints."""
        images, keypoints = batch
        logits = self.forward(images)
        weights = self.config.distance_weight, self.config.scale_weight
        return self.descend(heatmap_loss(logits, keypoints.to(DEVICE), self.model.input_size, *weights))

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
    scores: dict[str, float]  # of the finished net


def train(config: KeypointConfig, root: Path, out: Path, init: Path | None = None, workers: int = 0) -> Trained:
    """Trains (or goes on training) one object's net; `out` gets checkpoint.pt, log.csv, curves.png and sheet.png.

    `workers` processes prepare batches; with none the training does so itself.
    """
    out.mkdir(parents=True, exist_ok=True)
    if config.loss not in LOSSES:
        raise ValueError(f"loss {config.loss!r}: choose one of {', '.join(LOSSES)}")
    views = Views(config, root)
    data = Data(config, root, views)
    trainer = Trainer(config, views.registration.keypoints, init)
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        trainer.resume(checkpoint, DEVICE)
    validator = Validator(config, root, views)
    source, step = (
        (data, trainer.component_step) if config.loss == "component" else (Pairs(config, views), trainer.pairwise_step)
    )
    batches = load(source, data, config, trainer.step, workers)
    log = Log(out / "log.csv")
    losses, started, scores = [], time.time(), None
    with tqdm(total=config.steps, initial=trainer.step, desc=config.name, mininterval=10) as bar:
        while trainer.step < config.steps:
            losses.append(step(next(batches)))
            bar.update()
            if trainer.step % CHECKPOINT_EVERY and trainer.step != config.steps:
                continue
            bar.set_postfix(loss=f"{np.mean(losses):.3f}")
            trainer.save(checkpoint)
            row = {"step": trainer.step, "seconds": round(time.time() - started), "loss": round(np.mean(losses), 4)}
            if trainer.step % VALIDATE_EVERY == 0 or trainer.step == config.steps:
                scores = validator(trainer.average)
                row |= {key: round(value, 3) for key, value in scores.items()}
                bar.write(f"step {trainer.step}: " + ", ".join(f"{k} {v:.1f}" for k, v in scores.items()))
                draw_progress(views, trainer.average, out)
                if joined := join_components(views, trainer.average):
                    data.add_placed()
                    batches = load(source, data, config, trainer.step, workers)
                    bar.write(f"step {trainer.step}: {joined} more components placed")
            log.write(row)
            draw_curves(log, out / "curves.png")
            losses = []
    return Trained(trainer.average, views, validator(trainer.average) if scores is None else scores)


def draw_progress(views: Views, model: KeypointNet, out: Path) -> None:
    """The keypoints on held-out views, `sheet.png`."""
    if views.held_out:
        held_out = [views.all[index] for index in views.held_out]
        draw_sheet(predictor(model, views.heights), held_out, views.targets(views.held_out), out / "sheet.png")


def load(source: Data | Pairs, data: Data, config: KeypointConfig, first: int, workers: int):
    def strength(step: int) -> float:
        return config.augmentation * augmentation_fade(step / config.steps)

    batches = Batches(source, data, config, first, strength)
    # Forked, so that workers share the patches and need no copy of `strength`.
    context = "fork" if workers else None
    return iter(
        torch.utils.data.DataLoader(batches, batch_size=None, num_workers=workers, multiprocessing_context=context)
    )


def join_components(views: Views, model: KeypointNet) -> int:
    """Lets the net place components that geometry alone cannot; returns how many joined."""
    waiting = [index for index in range(len(views.all)) if index not in views.registration.placed]
    if not waiting:
        return 0
    predictions = predict_views(predictor(model, views.heights), [views.all[index] for index in waiting])
    poses = [solve_pose(views.registration.keypoints, prediction) for prediction in predictions]
    return join(views.registration, dict(zip(waiting, poses)))


def augmentation_fade(progress: float) -> float:
    """1 for half of the training, then falling to FINAL_AUGMENTATION."""
    return 1 - (1 - FINAL_AUGMENTATION) * max(0.0, min(1.0, (progress - 0.5) / 0.3))


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
