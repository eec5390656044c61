"""A packed dataset teaches what the whole one does."""

from dataclasses import replace

import numpy as np
import pytest

from posed_train import bop, config, crops, data, pack

SETTINGS = config.KeypointConfig(name="motor", obj_id=3, photoreal="train", held_out_scenes=1, min_visible=0.3)


def test_patches_and_targets_stay_the_same(rendered, tmp_path):
    written = pack.pack(SETTINGS, rendered, tmp_path / "small")
    whole, packed = data.Views(SETTINGS, rendered), data.Views(SETTINGS, tmp_path / "small")
    assert 0 < written < sum(path.stat().st_size for path in rendered.rglob("*.jpg"))
    np.testing.assert_allclose(packed.registration.keypoints, whole.registration.keypoints, rtol=1e-6)
    indices = range(len(whole.all))
    for before, after, targets, others in zip(whole.all, packed.all, whole.targets(indices), packed.targets(indices)):
        first, second = (crops.cut_patch(v, t, 128, with_mask=True) for v, t in ((before, targets), (after, others)))
        np.testing.assert_allclose(first.keypoints, second.keypoints, atol=1e-3)
        assert np.abs(first.rgb.astype(int) - second.rgb).mean() < 4
        assert (np.abs(first.mask.astype(int) - second.mask) > 128).mean() < 0.01


def test_refuses_to_overwrite_and_names_what_is_missing(rendered, tmp_path):
    with pytest.raises(OSError, match="exists already"):
        pack.pack(SETTINGS, rendered, tmp_path)
    without_photos = replace(SETTINGS, backgrounds="nowhere")
    with pytest.raises(bop.DatasetError, match="nowhere"):
        pack.pack(without_photos, rendered, tmp_path / "small")
