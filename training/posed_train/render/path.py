"""A camera that goes past a scene, as a film: thirty images a second."""

import numpy as np

from .layout import Camera, about_z, direction, look_at

IMAGES_PER_SECOND = 30
SWING = np.radians(50)
"""How far the camera goes to either side."""
MOVES_AT = (0.25, 0.75)
"""Shares of the film between which the first object is on its way."""
MOVES_M, MOVES_RAD = 0.12, 2.0


def camera_path(placed: list[np.ndarray], images: int, rng: np.random.Generator) -> list[Camera]:
    """Once to and fro about the objects, nearer and farther, with a hand's slow sway."""
    centre = np.mean([pose[:3, 3] for pose in placed], axis=0)
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(35, 55))
    distance = rng.uniform(0.45, 0.6)
    sway = rng.uniform(0, 2 * np.pi, 3)
    cameras = []
    for image in range(images):
        phase = 2 * np.pi * image / max(images, 2)
        time_s = image / IMAGES_PER_SECOND
        towards = direction(azimuth + SWING * np.sin(phase), elevation + 0.15 * np.sin(2 * phase + sway[0]))
        position = centre + distance * (1 + 0.12 * np.sin(phase + sway[1])) * towards
        roll = 0.08 * np.sin(1.3 * time_s + sway[2])
        target = centre + 0.015 * np.sin(0.9 * time_s + sway)
        cameras.append(Camera(look_at(position, target, roll)))
    return cameras


def moved(start: np.ndarray, images: int, rng: np.random.Generator) -> list[np.ndarray]:
    """`world_from_object` of an object that rests, slides away over the table while it turns, and rests again."""
    away = direction(rng.uniform(0, 2 * np.pi), 0) * MOVES_M
    poses = []
    for image in range(images):
        begun = np.clip((image / images - MOVES_AT[0]) / (MOVES_AT[1] - MOVES_AT[0]), 0, 1)
        share = begun * begun * (3 - 2 * begun)  # starts and stops softly
        pose = start.copy()
        pose[:3, :3] = about_z(MOVES_RAD * share) @ start[:3, :3]
        pose[:3, 3] = start[:3, 3] + away * share
        poses.append(pose)
    return poses
