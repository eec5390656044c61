"""Variation of a crop's colours: other light, other cameras' exposure and rendering of colours.

All but the hue merges is, for each channel, a curve, and then one affine map of all three.
"""

import cv2
import numpy as np

OTHER_CAMERA_SHARE = 0.7
"""Of the crops: another camera's colours in another light."""
TURNED_SHARE, SATURATED_SHARE, TEMPERATURE_SHARE = 0.3, 0.15, 0.4
"""Of these: hues turned, colours driven into saturation, and light of another temperature."""
MERGED_SHARE = 0.12
"""Of the crops: neighbouring hues made equal, as cameras do beyond their gamut (orange is red then)."""
# Standard deviations.
MIX, LOG_GAIN, LOG_GAMMA, TURN_DEG, LOG_EXPOSURE = 0.08, 0.22, 0.15, 14.0, 0.2
METERED = 20.0, 190.0
MERGED_WIDTH_DEG = 20.0, 50.0
MIN_CHROMA = 60
"""Least saturation (0..255) of a pixel whose hue says something."""
WARMEST_K, COLDEST_K = 2500.0, 10000.0
# sRGB of black bodies (CIE 1931 observer), by temperature.
BLACK_BODIES = {
    2500: (255, 161, 72),
    3000: (255, 180, 107),
    4000: (255, 209, 163),
    5000: (255, 228, 206),
    6500: (255, 249, 253),
    8000: (227, 233, 255),
    10000: (204, 219, 255),
}


def vary_colour(crop: np.ndarray, rng: np.random.Generator, strength: float) -> np.ndarray:
    """Of `[S, S, 3]` uint8: float32, not clipped. Other cameras will come, however little the rest varies towards the
    end of a training: their share falls only where the strength is below a half."""
    other = rng.random() < OTHER_CAMERA_SHARE * min(1.0, 2 * strength)
    gammas = np.full(3, np.exp(rng.normal(0, 0.25 * strength)))
    if other:
        gammas = gammas * np.exp(rng.normal(0, LOG_GAMMA, 3))
    curves = 255 * (np.arange(256)[:, None] / 255) ** gammas
    crop = cv2.LUT(crop, curves[:, None].astype(np.float32))
    matrix = saturation(rng.uniform(1 - 0.4 * strength, 1 + 0.3 * strength))
    contrast = rng.uniform(1 - 0.35 * strength, 1 + 0.35 * strength)
    gains = rng.uniform(1 - 0.12 * strength, 1 + 0.12 * strength, 3)
    gains = gains * rng.uniform(1 - 0.35 * strength, 1 + 0.35 * strength)
    mean = np.array(cv2.mean(crop)[:3])
    offset = (1 - contrast) * mean.mean() * gains + rng.normal(0, 8 * strength)
    matrix = (gains * contrast)[:, None] * matrix
    if other:
        foreign = other_camera(rng)
        matrix, offset = foreign @ matrix, foreign @ offset
    affine = np.column_stack([matrix, offset])
    return cv2.transform(crop, (metered(affine, mean) * affine).astype(np.float32))


def metered(affine: np.ndarray, mean: np.ndarray) -> float:
    """What keeps the mean of a crop, once mapped, within what a camera's exposure leaves of it."""
    level = float((affine @ [*mean, 1]).mean())
    return float(np.clip(level, *METERED) / level) if level > 0 else 1.0


def saturation(factor: float) -> np.ndarray:
    """Moves colours away from their grey."""
    return factor * np.eye(3) + (1 - factor) / 3


def other_camera(rng: np.random.Generator) -> np.ndarray:
    """How another camera shows the same colours, `[3, 3]`."""
    mix = np.eye(3) + rng.normal(0, MIX, (3, 3))
    matrix = mix / mix.sum(1, keepdims=True)
    if rng.random() < TURNED_SHARE:
        matrix = hue_turn(np.radians(rng.normal(0, TURN_DEG))) @ matrix
    if rng.random() < SATURATED_SHARE:
        matrix = saturation(rng.uniform(1.3, 2.2)) @ matrix
    gains = np.exp(rng.normal(0, LOG_GAIN, 3))
    if rng.random() < TEMPERATURE_SHARE:
        gains = temperature_gains(1e6 / rng.uniform(1e6 / COLDEST_K, 1e6 / WARMEST_K))
    return np.exp(rng.normal(0, LOG_EXPOSURE)) * gains[:, None] * matrix


def temperature_gains(kelvin: float) -> np.ndarray:
    """How much of each channel a camera that is balanced for daylight sees in light of this temperature, mean 1."""
    mireds = [1e6 / known for known in reversed(BLACK_BODIES)]
    colours = np.array(list(reversed(BLACK_BODIES.values())), float)
    gains = np.array([np.interp(1e6 / kelvin, mireds, channel) for channel in colours.T]) / BLACK_BODIES[6500]
    return gains / gains.mean()


def hue_turn(angle: float) -> np.ndarray:
    """The rotation `[3, 3]` about the grey axis."""
    axis = np.ones(3) / np.sqrt(3)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def merge_hues(crop: np.ndarray, mask: np.ndarray | None, rng: np.random.Generator) -> np.ndarray:
    """Makes the hues about one of the object's own alike, `[S, S, 3]` uint8."""
    hsv = cv2.cvtColor(crop, cv2.COLOR_RGB2HSV)  # of hues 0..179, two degrees each
    own = hsv[mask > 127] if mask is not None else hsv.reshape(-1, 3)
    own = own[own[:, 1] > MIN_CHROMA]
    if not len(own):
        return crop
    # Between the colours of a pair lies the hue that both become.
    reach = rng.uniform(*MERGED_WIDTH_DEG) / 4
    centre = float(own[rng.integers(len(own)), 0]) + rng.uniform(-reach, reach)
    hues = np.arange(256)
    away = (hues - centre + 90) % 180 - 90
    merged = np.where(np.abs(away) < reach, np.round(centre) % 180, hues).astype(np.uint8)
    hsv[..., 0] = cv2.LUT(np.ascontiguousarray(hsv[..., 0]), merged)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)
