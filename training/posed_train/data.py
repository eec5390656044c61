"""One object's views: registered, cut into patches, drawn into batches."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from . import bop
from .augment import Augmenter
from .check import MIN_BASELINE_DEG
from .config import KeypointConfig, splits
from .crops import Patch, as_matrix, axis_in_image, cut_patch, transform
from .network import design
from .registration import (
    JOIN_DISTANCE_OF_SIZE,
    JOIN_ROTATION_DEG,
    Registration,
    agree,
    angles_deg,
    consensus,
    mean_pose,
    project,
    register,
)

MAX_BACKGROUND_PX = 360
MIN_RASTERISED_PX = 28
LEAST_TO_HOLD_OUT = 8
"""Of fewer placed views none is held out: all are needed to learn from."""
ENOUGH_HELD_OUT = 12
"""With fewer, some views of the scenes that are placed later are held out, too."""
MIN_ADOPTED = 0.2
"""Share of the views in which a net that training goes on from must see one frame of its keypoints."""
DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")


class Views:
    """The views of one object, registered by components; some are held out for calibrating the covariances."""

    def __init__(self, config: KeypointConfig, root: Path):
        photoreal = read_photoreal(config, root)
        rasterised = read_splits(config.rasterised, config, root, MIN_RASTERISED_PX)
        self.all = photoreal + rasterised + read_novel_views(config, root)
        self.photoreal_count = len(photoreal)
        self.registration = register(self.all, config.poses, config.seed, config.keypoint_shape, config.keypoint_count)
        self.held_out = held_out(photoreal, self.registration, config)
        self.find_directions(config)

    def find_directions(self, config: KeypointConfig) -> None:
        """Those of the object's frame that matter to the net, in the frame of the keypoints."""
        # The net's keypoints are where they were placed: it can be taught to look at them more closely. The pairwise
        # losses leave their frame to the net.
        known = self.keypoints_from_object
        self.up = self.heights = self.front = None
        if config.loss == "component":
            self.up = direction(config.up, known) if config.up else np.array([0.0, 0.0, 1.0])
            # Coordinates of the keypoints along it, `[N]`.
            self.heights = self.registration.keypoints @ self.up
            self.front = direction(config.front, known) if config.front else None
        self.motions = symmetry_motions(config.symmetries_discrete, known)

    def adopt(
        self, config: KeypointConfig, keypoints: np.ndarray, camera_from_keypoints: dict[int, np.ndarray | None]
    ) -> None:
        """Places the keypoints of a net that has been trained where it sees them in the views of the largest component.
        Of the ways in which a symmetric object looks the same it is the one nearest to the frame chosen before."""
        first, chosen = self.registration.components[0], self.registration.components[0].component_from_keypoints
        placed = dict(zip(first.views, first.camera_from_component))
        votes = [
            np.linalg.inv(placed[index]) @ pose for index, pose in camera_from_keypoints.items() if pose is not None
        ]
        thresholds = JOIN_ROTATION_DEG, JOIN_DISTANCE_OF_SIZE * self.registration.size_m
        voted = consensus(np.stack(votes), *thresholds) if votes else None
        alike = agree(np.stack(votes), voted[None], *thresholds).sum() if votes else 0
        if alike < max(2, MIN_ADOPTED * len(camera_from_keypoints)):
            raise bop.DatasetError(
                f"--init: that net sees its object alike in {alike} of {len(camera_from_keypoints)} views of this "
                "dataset; is it a net of this object? Leave --init out to start anew"
            )
        self.place_keypoints(config, keypoints, voted)
        nearest = min(voted @ self.motions, key=lambda pose: angles_deg(pose[None], chosen[None]))
        self.place_keypoints(config, keypoints, nearest)

    def place_keypoints(self, config: KeypointConfig, keypoints: np.ndarray, placement: np.ndarray) -> None:
        """Puts keypoints `[N, 3]` where `placement`, `component_from_keypoints` of the largest component, says."""
        self.registration.keypoints = keypoints
        self.registration.place(self.registration.components[0], placement)
        self.find_directions(config)

    @property
    def keypoints_from_object(self) -> np.ndarray | None:
        """For scores only: where the dataset's object frame lies among the keypoints, if it states object poses."""
        known = [
            np.linalg.inv(placed) @ self.all[index].camera_from_object
            for index, placed in self.registration.placed.items()
            if self.all[index].camera_from_object is not None
        ]
        return mean_pose(np.stack(known)) if known else None

    @property
    def judging(self) -> list[int]:
        """Those that tell how well a net does: held out; or, where none are, some of those that it learned from."""
        if self.held_out:
            return self.held_out
        placed = [index for index in sorted(self.registration.placed) if index < self.photoreal_count]
        return placed[:: -(-len(placed) // ENOUGH_HELD_OUT)]

    def hold_out_of(self, placed: list[int], config: KeypointConfig) -> bool:
        """Holds out some of the views that have just been placed, where few are so far; says whether it did."""
        photoreal = [index for index in placed if index < self.photoreal_count]
        wanted = sum(index < self.photoreal_count for index in self.registration.placed) // config.held_out_every
        count = min(wanted, ENOUGH_HELD_OUT) - len(self.held_out)
        if count <= 0 or not photoreal:
            return False
        more = photoreal[:: -(-len(photoreal) // count)]
        self.held_out = sorted({*self.held_out, *more})
        return True

    def targets(self, indices: list[int]) -> np.ndarray:
        """Where the keypoints are, `[V, S, N, 2]` image pixels: once for each of the S motions under which the object
        looks the same (S = 1 where none is declared)."""
        cameras = np.stack([self.all[index].camera_matrix for index in indices])
        poses = np.stack([self.registration.placed[index] for index in indices])
        alike = [project(cameras, poses @ motion, self.registration.keypoints) for motion in self.motions]
        return np.stack(alike, axis=1)

    def targets_in_front(self, indices: list[int]) -> np.ndarray:
        """Of the targets that differ in where `front` points alone, those where it points to the camera: one for each
        direction that `up` may have, `[V, S', N, 2]`. All of them where no `front` is given."""
        targets = self.targets(indices)
        if self.front is None:
            return targets
        poses = np.stack([self.registration.placed[index] for index in indices])
        turns = self.motions[:, :3, :3]
        facing = -np.einsum("vi,vij,sj->vs", poses[:, :3, 3], poses[:, :3, :3], turns @ self.front)
        _, kinds = np.unique((turns @ self.up).round(3), axis=0, return_inverse=True)
        alike = [np.flatnonzero(kinds.ravel() == kind) for kind in range(kinds.max() + 1)]
        chosen = np.stack([motions[facing[:, motions].argmax(1)] for motions in alike], axis=1)
        return np.take_along_axis(targets, chosen[..., None, None], axis=1)


def direction(in_object: list[float], keypoints_from_object: np.ndarray | None) -> np.ndarray:
    """A direction of the object's frame, `[3]` in the keypoints'."""
    if keypoints_from_object is None:
        raise bop.DatasetError("`up` and `front` are in the object's frame, but the dataset states no object poses")
    return keypoints_from_object[:3, :3] @ in_object


def symmetry_motions(declared: list[list[float]], keypoints_from_object: np.ndarray | None) -> np.ndarray:
    """`[S, 4, 4]`, identity first: discrete symmetries (BOP: 4x4 row-major, mm) moved to the keypoints' frame."""
    if not declared:
        return np.eye(4)[None]
    if keypoints_from_object is None:
        raise bop.DatasetError("symmetries are declared in the object's frame, but the dataset states no object poses")
    return keypoints_from_object @ bop.symmetry_motions(declared) @ np.linalg.inv(keypoints_from_object)


def read_photoreal(config: KeypointConfig, root: Path) -> list[bop.View]:
    return read_splits(config.photoreal, config, root)


def read_novel_views(config: KeypointConfig, root: Path) -> list[bop.View]:
    """As views of the scenes that they were made of: they share the frame of their cameras."""
    folder = root / config.novel_views
    if not config.novel_views:
        return []
    made_of = [split for split in splits(config.photoreal) if (folder / split).is_dir()]
    if not made_of:
        raise bop.DatasetError(f"{folder}: no novel views of {config.photoreal}; `posed-train novel-views` makes them")
    return [
        replace(view, split=str(root / split))
        for split in made_of
        for view in bop.read_views(folder / split, config.obj_id)
    ]


def read_splits(
    setting: str | list[str], config: KeypointConfig, root: Path, min_box_px: int = bop.MIN_BOX_PX
) -> list[bop.View]:
    return [
        view
        for split in splits(setting)
        for view in bop.read_views(root / split, config.obj_id, config.min_visible, min_box_px)
    ]


def held_out(photoreal: list[bop.View], registration: Registration, config: KeypointConfig) -> list[int]:
    """Indices of placed views: those of the last scenes, or some of every scene where there are few."""
    scenes = sorted({(view.split, view.scene) for view in photoreal})
    last = set(scenes[len(scenes) - config.held_out_scenes :]) if len(scenes) >= 2 * config.held_out_scenes else set()
    placed = [index for index in range(len(photoreal)) if index in registration.placed]
    chosen = [index for index in placed if (photoreal[index].split, photoreal[index].scene) in last]
    # Scenes whose components are placed later, by the net itself, cannot tell how good it is; nor can none. And some
    # views must be left to learn from: the one scene that is placed may be one of the last, or a mere pair.
    if chosen and len(chosen) < len(placed):
        return chosen
    return placed[:: config.held_out_every] if len(placed) >= LEAST_TO_HOLD_OUT else []


class Data:
    """The training views cut into patches."""

    def __init__(self, config: KeypointConfig, root: Path, views: Views):
        self.config, self.views = config, views
        self.input_size = design(config.network).input_size
        self.photoreal: list[Patch] = []
        self.rasterised: list[Patch] = []
        self.cut: set[int] = set()
        self.add_placed()
        self.backgrounds = read_backgrounds(root / config.backgrounds, self.input_size) if config.backgrounds else []

    def add_placed(self) -> None:
        """Cuts the views that have been placed since the last call."""
        done = self.cut.union(self.views.held_out)
        new = [index for index in sorted(self.views.registration.placed) if index not in done]
        self.cut.update(new)
        if not new:
            return
        targets = zip(new, self.views.targets_in_front(new))
        for index, keypoints in tqdm(targets, f"{self.config.name}: cutting crops", len(new), mininterval=5):
            pool = self.photoreal if index < self.views.photoreal_count else self.rasterised
            pool.append(cut_patch(self.views.all[index], keypoints, self.input_size, self.config.masks))

    def batch(self, size: int, augment: Augmenter, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Crops `[B, 3, S, S]` and keypoints `[B, symmetries, N, 2]` in crop pixels: of all places that a symmetric
        object leaves open, or, where a `front` is given, of the one that is to be learned."""
        photoreal = round(size * self.config.photoreal_share) if self.rasterised else size
        pools = [self.photoreal] * photoreal + [self.rasterised] * (size - photoreal)
        samples = [pool[rng.integers(len(pool))] for pool in pools]
        crops, affines = zip(*(augment(sample) for sample in samples))
        keypoints = [transform(affine, sample.keypoints) for sample, affine in zip(samples, affines)]
        if self.views.front is not None:
            keypoints = [most_upright(alike, self.views.heights)[None] for alike in keypoints]
        return to_images(crops), torch.from_numpy(np.stack(keypoints)).float()


def most_upright(alike: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Of equivalent keypoints `[S, N, 2]` those whose axis points most upwards, `[N, 2]`."""
    return min(alike, key=lambda keypoints: axis_in_image(keypoints, heights)[1])


@dataclass(frozen=True)
class PairBatch:
    """B pairs of views; the second views follow the first ones."""

    images: Tensor  # [2 B, 3, S, S]
    normalised_from_crop: Tensor  # [2 B, 2, 3]: crop pixels to the plane z = 1
    second_from_first: Tensor  # [B, 4, 4]

    def to(self, device: torch.device) -> "PairBatch":
        return PairBatch(
            *(value.to(device) for value in (self.images, self.normalised_from_crop, self.second_from_first))
        )


class Pairs:
    """Pairs of views of the same component, far enough apart to say something of depth."""

    def __init__(self, config: KeypointConfig, views: Views):
        size = design(config.network).input_size
        held_out = set(views.held_out)
        self.views, self.patches, self.partners = views, {}, []
        for component in views.registration.components:
            members = [index for index in component.views if index not in held_out]
            poses = dict(zip(component.views, component.camera_from_component))
            stacked = np.array([poses[index] for index in members]).reshape(-1, 4, 4)
            apart = angles_deg(stacked, stacked) > MIN_BASELINE_DEG
            for row, index in enumerate(members):
                if apart[row].any():
                    others = [(members[column], poses[members[column]]) for column in np.flatnonzero(apart[row])]
                    self.partners.append((index, poses[index], others))
        if not self.partners:
            raise bop.DatasetError(f"no two views of a component are {MIN_BASELINE_DEG:.0f} degrees apart")
        for index in tqdm({i for i, _, _ in self.partners}, f"{config.name}: cutting crops", mininterval=5):
            self.patches[index] = cut_patch(views.all[index], None, size, config.masks)

    def batch(self, size: int, augment: Augmenter, rng: np.random.Generator) -> PairBatch:
        firsts, seconds, relative = [], [], []
        for _ in range(size // 2):
            first, first_pose, others = self.partners[rng.integers(len(self.partners))]
            second, second_pose = others[rng.integers(len(others))]
            firsts.append(first)
            seconds.append(second)
            relative.append(second_pose @ np.linalg.inv(first_pose))
        crops, maps = [], []
        for index in firsts + seconds:
            patch = self.patches[index]
            crop, crop_from_patch = augment(patch)
            crops.append(crop)
            normalised_from_image = np.linalg.inv(self.views.all[index].camera_matrix)
            maps.append(
                (normalised_from_image @ np.linalg.inv(as_matrix(crop_from_patch) @ patch.patch_from_image))[:2]
            )
        as_tensor = lambda values: torch.from_numpy(np.stack(values)).float()  # noqa: E731
        return PairBatch(to_images(crops), as_tensor(maps), as_tensor(relative))


class Batches(torch.utils.data.IterableDataset):
    """The batches of all steps from one on. Each step has its own random numbers, so that a training that was stopped,
    or has other workers, sees the same batches."""

    def __init__(self, source: Data | Pairs, data: Data, config: KeypointConfig, steps: range, strength):
        self.source, self.config, self.steps, self.strength = source, config, steps, strength
        self.backgrounds, self.input_size, self.heights = data.backgrounds, data.input_size, data.views.heights

    def __iter__(self):
        worker = torch.utils.data.get_worker_info()
        offset, stride = (worker.id, worker.num_workers) if worker else (0, 1)
        for step in self.steps[offset::stride]:
            rng = np.random.default_rng([self.config.seed, step])
            augment = Augmenter(self.backgrounds, rng, self.input_size, self.heights, self.config.pasted_share)
            augment.strength = self.strength(step)
            yield self.source.batch(self.config.batch, augment, rng)


def to_images(crops: list[np.ndarray]) -> Tensor:
    """`[B, 3, S, S]` raw 8-bit, channels last in memory."""
    return torch.from_numpy(np.stack(crops)).permute(0, 3, 1, 2)


def read_backgrounds(folder: Path, least_px: int) -> list[np.ndarray]:
    """The photos of a folder that are at least this large, none much larger than needed."""
    images = []
    for path in sorted(folder.glob("*.jpg")):
        image = bop.read_rgb(path)
        scale = MAX_BACKGROUND_PX / min(image.shape[:2])
        if min(image.shape[:2]) >= least_px:
            image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
            images.append(image)
    if not images:
        raise bop.DatasetError(
            f"{folder}: no *.jpg of at least {least_px} px on its shorter side; `backgrounds` names it"
        )
    return images
