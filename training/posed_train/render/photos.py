"""Photos as a user takes them: objects stand still on a printed board of tags, the camera goes around them. They test
and show what `onboard` makes of photos."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from ..onboard.printing import Sheet, rasterise
from .layout import CAMERA_MATRIX, HEIGHT, WIDTH, Camera, Camouflage, Layout, Light, about_z, direction, look_at
from .objects import ObjectMesh
from .rasteriser import Rasteriser

PX_PER_MM = 6
OVERSAMPLING = 2
PAPER = np.array([236.0, 240.0, 242.0])
INK = np.array([34.0, 30.0, 28.0])


@dataclass(frozen=True)
class RenderedPhoto:
    image: np.ndarray  # [H, W, 3] RGB
    camera_from_world: np.ndarray  # [4, 4] metres; z up, origin in the middle of the board's upper side
    masks: list[np.ndarray]  # of what is seen of each object


def stand(item: ObjectMesh, x: float, y: float, turn: float) -> np.ndarray:
    """`world_from_object` on the board, on the side that it most likely lies on."""
    pose = np.eye(4)
    pose[:3, :3] = about_z(turn) @ item.resting_rotations[item.resting_probabilities.argmax()]
    pose[:3, 3] = x, y, -(item.mesh.vertices @ pose[:3, :3].T)[:, 2].min()
    return pose


def cameras_around(count: int, rng: np.random.Generator, distance_m: tuple[float, float]) -> list[Camera]:
    """On rings of three heights, looking about at the middle."""
    cameras = []
    for k in range(count):
        azimuth, elevation = 2.4 * k + rng.uniform(-0.1, 0.1), np.radians((22, 42, 63)[k % 3] + rng.uniform(-5, 5))
        position = rng.uniform(*distance_m) * direction(azimuth, elevation)
        target = np.append(rng.normal(0, 0.012, 2), 0.02)
        cameras.append(Camera(look_at(position, target, rng.normal(0, 0.15))))
    return cameras


def render_photos(
    objects: list[ObjectMesh],
    world_from_object: list[np.ndarray],
    sheet: Sheet,
    cameras: list[Camera],
    rng: np.random.Generator,
) -> Iterator[RenderedPhoto]:
    lights = [Light(1.5 * direction(angle, 1.0), np.full(3, 0.4)) for angle in (0.5, 2.6, 4.7)]
    engine = Rasteriser(objects, Camouflage(objects, 0))
    engine.open(Layout(world_from_object, 2.0, -0.5, [], lights, [], cameras), rng)
    print_, table = rasterise(sheet, PX_PER_MM), rng.integers(90, 170, (40, 40, 3)).astype(np.uint8)
    for camera in cameras:
        image = board_in(camera, sheet, print_, table)
        visible = engine.visible(camera)
        image[visible > 0] = engine.colour(camera)[visible > 0]
        noisy = image + rng.normal(0, 2.0, image.shape)
        masks = [((visible == index + 1) * 255).astype(np.uint8) for index in range(len(objects))]
        yield RenderedPhoto(np.clip(noisy, 0, 255).astype(np.uint8), camera.camera_from_world, masks)


def world_from_board(sheet: Sheet) -> np.ndarray:
    """Of the sheet's frame: metres from its top left, x right, y down, z into it."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:2, 3] = -sheet.width / 2000, sheet.height / 2000
    return pose


def board_in(camera: Camera, sheet: Sheet, print_: np.ndarray, table: np.ndarray) -> np.ndarray:
    """The board on a mottled table, `[H, W, 3]` RGB; sampled more finely than it is shown."""
    pose = camera.camera_from_world @ world_from_board(sheet)
    fine_from_image = np.array(
        [[OVERSAMPLING, 0, (OVERSAMPLING - 1) / 2], [0, OVERSAMPLING, (OVERSAMPLING - 1) / 2], [0, 0, 1]]
    )
    fine_from_board = fine_from_image @ CAMERA_MATRIX @ pose[:3, [0, 1, 3]]
    texel = 1 / (1000 * PX_PER_MM)
    board_from_print = np.array([[texel, 0, texel / 2], [0, texel, texel / 2], [0, 0, 1]])
    size = OVERSAMPLING * WIDTH, OVERSAMPLING * HEIGHT
    shown = cv2.warpPerspective(
        print_, fine_from_board @ board_from_print, size, flags=cv2.INTER_LINEAR, borderValue=128
    )
    inside = cv2.warpPerspective(np.full_like(print_, 255), fine_from_board @ board_from_print, size)
    spread = np.array([[0.05, 0, -1.0], [0, 0.05, -1.0], [0, 0, 1]])  # 5 cm a spot
    around = cv2.warpPerspective(
        table, fine_from_board @ spread, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )
    share, on_board = shown[..., None] / 255.0, inside[..., None] / 255.0
    fine = on_board * (INK + share * (PAPER - INK)) + (1 - on_board) * around
    return cv2.resize(fine.astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
