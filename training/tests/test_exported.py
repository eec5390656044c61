"""Training that goes on from an exported net."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from posed_train import config, data, export, exported, train
from posed_train.bop import DatasetError
from posed_train.network import KeypointNet
from posed_train.registration import random_rotation

CUBE = config.KeypointConfig(
    name="cube", obj_id=1, photoreal="train", network="lite", held_out_scenes=1, min_visible=0.3, steps=2
)
CROPS = np.random.default_rng(3).integers(0, 256, (4, 160, 160, 3), np.uint8)


def lively(name: str) -> KeypointNet:
    """A net whose batch normalisation does something, as a trained one's does."""
    torch.manual_seed(4)
    net = KeypointNet(8, name)
    for layer in exported.normalised(net).values():
        torch.nn.init.uniform_(layer.weight, 0.5, 1.5)
        torch.nn.init.normal_(layer.bias, std=0.2)
        torch.nn.init.normal_(layer.running_mean, std=0.2)
        torch.nn.init.uniform_(layer.running_var, 0.5, 2)
    return net


@pytest.fixture(scope="module", params=["lite", "lite0"])
def network(request, rendered, tmp_path_factory):
    views = data.Views(replace(CUBE, network=request.param), rendered)
    out = tmp_path_factory.mktemp(request.param)
    export.export_keypoints(lively(request.param), views, out, {"name": "cube", "obj_id": 1}, {})
    return request.param, out / "keypoints.onnx", views


def logits(net: KeypointNet, training: bool = False) -> np.ndarray:
    with torch.no_grad():
        return net.train(training)(torch.from_numpy(CROPS).permute(0, 3, 1, 2).float() / 255).numpy()


def test_it_says_what_was_exported_and_normalises_again(network):
    name, path, _ = network
    net = KeypointNet(8, name)
    train.start_from(net, exported.unfold(net, exported.read_weights(path)))
    before = logits(net)
    expected = exported.predictor(path).run(CROPS)[0]
    np.testing.assert_allclose(
        export.KeypointExport(net, nn.Identity())(torch.from_numpy(CROPS))[0].detach(), expected, atol=0.02
    )
    exported.settle(net, [torch.from_numpy(CROPS[i : i + 2]).permute(0, 3, 1, 2).float() / 255 for i in (0, 2)])
    scale = np.abs(before).max()
    np.testing.assert_allclose(logits(net), before, atol=1e-3 * scale)
    # Training normalises by the batch, here the crops it settled on.
    np.testing.assert_allclose(logits(net, training=True), before, atol=2e-2 * scale)


def test_its_keypoints_stay_where_they_are_on_the_object(network, rendered):
    name, _, views = network
    other = data.Views(replace(CUBE, network=name, seed=8), rendered)
    members = views.registration.components[0].views
    assert not np.allclose(other.registration.placed[members[0]], views.registration.placed[members[0]], atol=0.1)
    smaller = 0.9 * views.registration.keypoints
    found = {index: views.registration.placed[index] for index in members}
    found[members[0]] = None  # no pose found
    found[members[1]] = found[members[1]] @ np.block([[random_rotation(5), np.zeros((3, 1))], [0, 0, 0, 1]])
    other.adopt(CUBE, smaller, found)
    np.testing.assert_array_equal(other.registration.keypoints, smaller)
    for index in members:
        np.testing.assert_allclose(other.registration.placed[index], views.registration.placed[index], atol=1e-9)
    np.testing.assert_allclose(other.heights, smaller[:, 2])
    with pytest.raises(DatasetError, match="net of this object"):
        other.adopt(CUBE, smaller, dict.fromkeys(members))


def test_a_training_that_goes_on_keeps_the_frame(network, rendered, tmp_path):
    name, path, views = network
    settings = replace(CUBE, network=name)
    with pytest.raises(DatasetError, match="net of this object"):
        train.train(settings, rendered, tmp_path / "noise", path)  # of a net that sees nothing
    adopted = views.registration.components[0].component_from_keypoints @ np.diag([-1, -1, 1, 1])
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "adopted.json").write_text(
        json.dumps({"keypoints_m": views.registration.keypoints.tolist(), "placement": adopted.tolist()})
    )
    trained = train.train(settings, rendered, tmp_path / "run", path)
    np.testing.assert_allclose(trained.views.registration.components[0].component_from_keypoints, adopted)


def test_of_another_network_or_no_network_is_refused(network, tmp_path):
    name, path, _ = network
    other = KeypointNet(8, "lite0" if name == "lite" else "lite")
    with pytest.raises(ValueError, match="of another network"):
        train.start_from(other, exported.unfold(other, exported.read_weights(path)))
    broken = tmp_path / "keypoints.onnx"
    broken.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(DatasetError, match="posed-train exported"):
        exported.read_weights(broken)
