"""The training loop of a keypoint net."""

import copy
import csv
import time
from pathlib import Path

import cv2
import numpy as np
import torch
from tqdm import tqdm

from . import bop, metrics, optimise
from .augment import Augmenter
from .config import KeypointConfig
from .crops import Patch, cut_patch
from .heatmap import Decode
from .losses import heatmap_loss
from .network import HEATMAP_STRIDE, INPUT_SIZE, KeypointNet
from .registration import project, register
from .validate import Predict, predict_views, score

VALIDATE_EVERY = 1000
CHECKPOINT_EVERY = 250
EMA_DECAY = 0.998
MAX_BACKGROUND_PX = 360
FINAL_AUGMENTATION = 0.4
DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")


class Views:
    """The views of one object, registered as one component."""

    def __init__(self, config: KeypointConfig, root: Path):
        photoreal = bop.read_views(root / config.photoreal, config.obj_id, config.min_visible)
        rasterised = (
            bop.read_views(root / config.rasterised, config.obj_id, config.min_visible, min_box_px=28)
            if config.rasterised
            else []
        )
        self.all = photoreal + rasterised
        self.photoreal_count = len(photoreal)
        self.registration = register(self.all, config.seed)
        first = self.registration.camera_from_keypoints[0]
        self.keypoints_from_object = np.linalg.inv(first) @ self.all[0].camera_from_object
        scenes = sorted({view.scene for view in photoreal})
        self.held_out_scenes = set(scenes[len(scenes) - config.held_out_scenes :])
        self.held_out = [view for view in photoreal if view.scene in self.held_out_scenes]


class Data:
    """The training views cut into patches."""

    def __init__(self, config: KeypointConfig, root: Path, views: Views):
        in_image = project(
            np.stack([view.camera_matrix for view in views.all]),
            views.registration.camera_from_keypoints,
            views.registration.keypoints,
        )
        self.photoreal: list[Patch] = []
        self.rasterised: list[Patch] = []
        for index, view in enumerate(tqdm(views.all, desc=f"{config.name}: cutting crops", mininterval=5)):
            if index >= views.photoreal_count:
                self.rasterised.append(cut_patch(view, in_image[index]))
            elif view.scene not in views.held_out_scenes:
                self.photoreal.append(cut_patch(view, in_image[index]))
        self.backgrounds = read_backgrounds(root / config.backgrounds) if config.backgrounds else []

    def batch(self, size: int, augment: Augmenter, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        pools = [pool for pool in (self.photoreal, self.rasterised) if pool]
        samples = [pools[i % len(pools)][rng.integers(len(pools[i % len(pools)]))] for i in range(size)]
        crops, keypoints = zip(*(augment(sample) for sample in samples))
        images = torch.from_numpy(np.stack(crops)).permute(0, 3, 1, 2).float() / 255
        images = images.to(DEVICE).contiguous(memory_format=torch.channels_last)
        return images, torch.from_numpy(np.stack(keypoints)).float().to(DEVICE)


def read_backgrounds(folder: Path) -> list[np.ndarray]:
    images = []
    for path in sorted(folder.glob("*.jpg")):
        image = bop.read_rgb(path)
        scale = MAX_BACKGROUND_PX / min(image.shape[:2])
        if min(image.shape[:2]) >= INPUT_SIZE:
            image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
            images.append(image)
    return images


def predictor(model: KeypointNet) -> Predict:
    decode = Decode(INPUT_SIZE // HEATMAP_STRIDE).to(DEVICE)

    @torch.no_grad()
    def predict(crops: np.ndarray):
        model.eval()
        images = torch.from_numpy(crops.copy()).to(DEVICE).permute(0, 3, 1, 2).float() / 255
        return tuple(output.cpu().numpy() for output in decode(model(images)))

    return predict


class Trainer:
    """Holds everything a checkpoint must hold."""

    def __init__(self, config: KeypointConfig, keypoints: int, init: Path | None):
        torch.manual_seed(config.seed)
        self.config, self.step = config, 0
        self.model = KeypointNet(keypoints).to(DEVICE, memory_format=torch.channels_last)
        if init is not None:
            self.model.load_state_dict(torch.load(init, map_location=DEVICE, weights_only=True)["average"])
        self.average = copy.deepcopy(self.model)
        self.optimizer = torch.optim.AdamW(self.model.parameters(), lr=config.learning_rate, weight_decay=1e-4)

    def train_step(self, images: torch.Tensor, keypoints: torch.Tensor) -> float:
        self.model.train()
        with torch.autocast(DEVICE.type, torch.bfloat16):
            logits = self.model(images)
        loss = heatmap_loss(logits, keypoints, self.config.distance_weight)
        rate = optimise.learning_rate(self.config.learning_rate, self.step, self.config.steps)
        value = optimise.descend(self.model, self.optimizer, loss, rate, self.step)
        self.step += 1
        self.update_average()
        return value

    @torch.no_grad()
    def update_average(self) -> None:
        decay = min(EMA_DECAY, (self.step + 1) / (self.step + 10))
        for average, current in zip(self.average.state_dict().values(), self.model.state_dict().values()):
            if average.dtype.is_floating_point:
                average.lerp_(current, 1 - decay)
            else:
                average.copy_(current)

    def save(self, path: Path) -> None:
        state = {
            "step": self.step,
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        optimise.save(state, path)

    def resume(self, path: Path) -> None:
        state = torch.load(path, map_location=DEVICE, weights_only=True)
        self.step = state["step"]
        self.model.load_state_dict(state["model"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])


def train(config: KeypointConfig, root: Path, out: Path, init: Path | None = None) -> tuple[KeypointNet, Views]:
    """Trains (or goes on training) one object's net; `out` gets checkpoint.pt and log.csv."""
    out.mkdir(parents=True, exist_ok=True)
    views = Views(config, root)
    data = Data(config, root, views)
    trainer = Trainer(config, len(views.registration.keypoints), init)
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        trainer.resume(checkpoint)
    rng = np.random.default_rng([config.seed, trainer.step])
    augment = Augmenter(data.backgrounds, rng)
    validator = Validator(config, root, views)
    losses, started = [], time.time()
    with (
        (out / "log.csv").open("a", newline="") as log_file,
        tqdm(total=config.steps, initial=trainer.step, desc=config.name, mininterval=10) as bar,
    ):
        log = csv.writer(log_file)
        while trainer.step < config.steps:
            augment.strength = config.augmentation * augmentation_fade(trainer.step / config.steps)
            losses.append(trainer.train_step(*data.batch(config.batch, augment, rng)))
            bar.update()
            if trainer.step % CHECKPOINT_EVERY == 0 or trainer.step == config.steps:
                bar.set_postfix(loss=f"{np.mean(losses):.3f}")
                trainer.save(checkpoint)
                scores = validator(trainer.average) if trainer.step % VALIDATE_EVERY == 0 else {}
                log.writerow([trainer.step, f"{time.time() - started:.0f}", f"{np.mean(losses):.4f}", scores])
                log_file.flush()
                if scores:
                    bar.write(f"step {trainer.step}: " + ", ".join(f"{k} {v:.1f}" for k, v in scores.items()))
                losses = []
    return trainer.average, views


def augmentation_fade(progress: float) -> float:
    """1 for half of the training, then falling to FINAL_AUGMENTATION."""
    return 1 - (1 - FINAL_AUGMENTATION) * max(0.0, min(1.0, (progress - 0.5) / 0.3))


class Validator:
    """Scores a model on the validation split, if there is one."""

    def __init__(self, config: KeypointConfig, root: Path, views: Views):
        self.registration, self.keypoints_from_object = views.registration, views.keypoints_from_object
        self.views = (
            bop.read_views(root / config.validation, config.obj_id, min_visible=0.7) if config.validation else []
        )
        if self.views:
            models = root / config.models
            info = bop.read_json(models / "models_info.json")[str(config.obj_id)]
            self.model = metrics.load_model(models / f"obj_{config.obj_id:06d}.ply", info)

    def __call__(self, model: KeypointNet) -> dict[str, float]:
        if not self.views:
            return {}
        predictions = predict_views(predictor(model), self.views)
        return score(self.model, self.registration.keypoints, self.keypoints_from_object, predictions)
