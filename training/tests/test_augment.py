import cv2
import numpy as np
import pytest

from posed_train.augment import PLAIN_SHARE, Augmenter
from posed_train.crops import CROP_SCALE, Patch, Square, axis_in_image
from posed_train.keypoints import virtual_keypoints
from posed_train.occlusion import cut_off, half_hide
from posed_train.registration import project

INPUT, SIZE = 128, 192
POINTS = virtual_keypoints("cube", 0.05, 8, 0)


def patch(rng: np.random.Generator) -> Patch:
    """A textured disc with the keypoints of a cube that is seen from anywhere."""
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pose[:3, :3] *= np.linalg.det(pose[:3, :3])
    pose[:3, 3] = [0, 0, 0.6]
    camera = np.array([[600.0, 0, SIZE / 2], [0, 600.0, SIZE / 2], [0, 0, 1]])
    mask = np.zeros((SIZE, SIZE), np.uint8)
    cv2.circle(mask, (90, 100), 40, 255, -1)
    rgb = rng.integers(0, 256, (SIZE, SIZE, 3)).astype(np.uint8)
    keypoints = project(camera[None], pose[None], POINTS)
    border = (-0.5, -0.5, SIZE - 0.5, SIZE - 0.5)
    return Patch(rgb, mask, keypoints, np.eye(3), border, Square.around(cv2.boundingRect(mask), 1.0))


@pytest.fixture
def vary() -> Augmenter:
    rng = np.random.default_rng(5)
    return Augmenter([rng.integers(0, 256, (200, 250, 3)).astype(np.uint8)], rng, INPUT, POINTS[:, 2])


def test_a_half_hidden_objects_box_is_of_what_is_left(vary):
    shares = []
    for _ in range(50):
        before = patch(vary.rng)
        after = half_hide(before, vary.surroundings.photo(), vary.rng)
        assert (after.mask <= before.mask).all()
        assert after.box == Square.around(cv2.boundingRect(after.mask), 1.0)
        left = after.mask == 255  # not the smooth edge
        np.testing.assert_array_equal(after.rgb[left], before.rgb[left])
        hidden = (before.mask > 0) & (after.mask == 0)
        assert not hidden.any() or (after.rgb[hidden] != before.rgb[hidden]).mean() > 0.9
        shares.append(left.mean() / (before.mask > 0).mean())
    assert 0.3 < min(shares) < 0.5 and max(shares) > 0.85


def test_an_object_cut_off_by_the_border_has_black_beyond(vary):
    """As in the crops that the service cuts: exactly black, and the box ends at the border."""
    for _ in range(50):
        before = patch(vary.rng)
        after = cut_off(before, vary.rng)
        assert after.box == Square.around(cv2.boundingRect(after.mask), 1.0)
        assert 0.35 < (after.mask > 0).mean() / (before.mask > 0).mean() < 0.95
        moved = [side for side in range(4) if after.border[side] != before.border[side]]
        assert len(moved) == 1
        axis, high = moved[0] % 2, moved[0] >= 2
        crop, crop_from_patch = vary(after)
        in_patch = np.stack(np.meshgrid(*[np.arange(INPUT)] * 2), -1) - crop_from_patch[:, 2]
        along = (in_patch @ np.linalg.inv(crop_from_patch[:, :2]).T)[..., axis]
        beyond = (along - after.border[moved[0]]) * (1 if high else -1)
        assert (crop[beyond > 1.5] == 0).all()
        assert crop[beyond < -1.5].any()


def test_whole_objects_stand_before_black_to_the_end(vary):
    """As beyond a border: else a net takes an object before a black backdrop for one that is cut off."""
    vary.strength, black, plain = 0.0, 0, 0
    mask = patch(vary.rng).mask
    shown = np.full((INPUT, INPUT, 3), 200, np.uint8)
    whole = cv2.resize(mask, (INPUT, INPUT))
    for _ in range(400):
        placed = vary.place(shown, whole, whole=True)
        assert (placed[whole == 255] == 200).all()
        black += not placed[whole == 0].any()
        plain += (placed[whole == 0] == placed[0, 0]).all() and placed[0, 0, 0] != 200
    assert 0.5 * PLAIN_SHARE < plain / 400 < 1.6 * PLAIN_SHARE
    assert 0.1 * PLAIN_SHARE < black / 400 < 0.5 * PLAIN_SHARE


def test_a_pasted_object_is_lit_alone(vary):
    shown, whole = np.full((INPUT, INPUT, 3), 100, np.uint8), np.zeros((INPUT, INPUT), np.uint8)
    whole[40:90, 40:90] = 255
    vary.surroundings.photos = [np.full((200, 250, 3), 7, np.uint8)]
    lit = 0
    for _ in range(200):
        placed = vary.place(shown, whole, whole=False)
        if (placed[whole == 0] == 7).all():
            lit += np.ptp(placed[whole == 255]) > 5
    assert lit > 5


def test_second_looks_are_upright_and_about_the_keypoints(vary):
    leans = []
    for _ in range(300):
        shown = patch(vary.rng)
        box = vary.second_box(shown)
        keypoints = box.scaled(CROP_SCALE).to_crop(shown.keypoints[0], INPUT)
        np.testing.assert_allclose(keypoints.mean(0), (INPUT - 1) / 2, atol=1e-6)
        across, down = axis_in_image(keypoints, POINTS[:, 2])
        leans.append(np.degrees(np.arctan2(across, -down)))
    # Only where the axis points at the camera does its direction say little.
    assert np.median(np.abs(leans)) < 10 < np.max(np.abs(leans))
