"""Views cut off by the photo's border are true to the whole ones."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from posed_train import bop, cut_off


def test_a_cut_view_shows_part_of_the_whole_one_where_it_was(rendered: Path, tmp_path: Path):
    split = rendered / "train"
    count = cut_off.cut_off(split, tmp_path / "cut", [1])
    whole = bop.read_views(split, 1, cut_off.LEAST_VISIBLE)
    views = bop.read_views(tmp_path / "cut", 1, min_box_px=1)
    assert count == len(views) == cut_off.CUTS_PER_VIEW * len(whole) > 0
    for view, before in zip(views, np.repeat(whole, cut_off.CUTS_PER_VIEW)):
        np.testing.assert_allclose(view.camera_from_object, before.camera_from_object, atol=1e-9)
        seen, photo = bop.read_rgb(view.image_path), bop.read_rgb(before.image_path)
        # What the camera matrices say of the corner is what the pixels say.
        left, top = (before.camera_matrix - view.camera_matrix)[:2, 2].round().astype(int)
        np.testing.assert_array_equal(seen, photo[top : top + len(seen), left : left + seen.shape[1]])
        x, y, w, h = view.box
        mask = bop.read_mask(before)[top : top + len(seen), left : left + seen.shape[1]] > 0
        assert mask[y : y + h, x : x + w].sum() == mask.sum() > 0
        shown = mask.sum() / (bop.read_mask(before) > 0).sum()
        assert view.visible_fraction == pytest.approx(before.visible_fraction * shown)
        assert 0.3 < shown < 0.75
        assert 0 in (x, y) or x + w == seen.shape[1] or y + h == seen.shape[0]


def test_strips_that_are_no_images_are_left_out(rendered: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    split = rendered / "train"
    every = cut_off.cut_off(split, tmp_path / "every", [1])
    sides = sorted(min(bop.read_rgb(view.image_path).shape[:2]) for view in bop.read_views(tmp_path / "every", 1, 0, 1))
    least = sides[len(sides) // 2] + 1
    monkeypatch.setattr(cut_off, "LEAST_SIDE_PX", least)
    assert cut_off.cut_off(split, tmp_path / "wide", [1]) == sum(side >= least for side in sides) < every


def test_what_cannot_be_cut_is_refused(rendered: Path, tmp_path: Path):
    with pytest.raises(OSError, match="exists already"):
        cut_off.cut_off(rendered / "train", tmp_path, [1])
    with pytest.raises(bop.DatasetError, match="no usable view of object 9"):
        cut_off.cut_off(rendered / "train", tmp_path / "cut", [1, 9])
    without_masks = tmp_path / "without"
    shutil.copytree(rendered / "train", without_masks, ignore=shutil.ignore_patterns("mask_visib"))
    with pytest.raises(bop.DatasetError, match="no mask in mask_visib"):
        cut_off.cut_off(without_masks, tmp_path / "cut", [1])
    assert not (tmp_path / "cut").exists()
