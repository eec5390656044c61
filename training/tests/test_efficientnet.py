"""The encoder that starts from ImageNet."""

import importlib.machinery

import pytest
import torch
from efficientnet_lite_pytorch import EfficientNet

from posed_train import efficientnet
from posed_train.network import KeypointNet


def test_features_are_those_that_the_weights_were_made_for():
    encoder = efficientnet.Encoder()
    encoder.load_imagenet()
    known = EfficientNet.from_name("efficientnet-lite0")
    known.load_state_dict(torch.load(efficientnet.weights_path(), weights_only=True))
    torch.manual_seed(0)
    x, expected = torch.rand(2, 3, 160, 160) * 2 - 1, []
    with torch.no_grad():
        encoder.eval()
        known.eval()
        y = torch.relu(known._bn0(known._conv_stem(x))).clamp(max=6)
        for number, block in enumerate(known._blocks):
            y = block(y)
            if number in (0, 2, 4, 10, 15):
                expected.append(y)
        found = encoder(x)
    assert [f.shape[1:] for f in found] == [(16, 80, 80), (24, 40, 40), (40, 20, 20), (112, 10, 10), (320, 5, 5)]
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=1e-4)


def test_the_input_is_normalised_as_it_was_trained():
    net = KeypointNet(8, "lite0")
    seen = []
    net.design.encoder.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    grey = torch.tensor([0.0, 127.0, 255.0]).view(3, 1, 1, 1).expand(3, 3, 32, 32)
    net.eval()(grey / 255)
    torch.testing.assert_close(seen[0][:, 0, 0, 0], torch.tensor([-127 / 128, 0.0, 1.0]))
    assert 3.1e6 < sum(value.numel() for value in net.parameters()) < 3.3e6


def test_without_the_known_weights_there_is_no_encoder(monkeypatch, tmp_path):
    monkeypatch.setattr(efficientnet, "PACKAGE", "efficientnet_lite9")
    with pytest.raises(OSError, match=r"efficientnet_lite9, .* not installed"):
        efficientnet.weights_path()
    path = tmp_path / efficientnet.WEIGHTS
    package = importlib.machinery.ModuleSpec("other", None, origin=str(tmp_path / "__init__.py"))
    monkeypatch.setattr(efficientnet.importlib.util, "find_spec", lambda _: package)
    with pytest.raises(OSError, match="missing"):
        efficientnet.weights_path()
    path.parent.mkdir()
    path.write_bytes(b"other weights")
    with pytest.raises(OSError, match="SHA-256"):
        efficientnet.Encoder().load_imagenet()


def test_deep_features_count_beside_the_large_ones_of_the_encoder():
    torch.manual_seed(0)
    decoder = KeypointNet(8, "lite0").design.decoder
    shallow = [8 * torch.randn(4, width, 32 // 2**i, 32 // 2**i) for i, width in enumerate((16, 24, 40, 112))]
    with torch.no_grad():
        one, other = (decoder([*shallow, torch.randn(4, 320, 2, 2)]) for _ in range(2))
    assert (one - other).std() > 0.3 * one.std()


def test_a_larger_input_goes_on_from_the_same_weights():
    small, large = (KeypointNet(8, name).eval() for name in ("lite0", "lite0-224"))
    large.load_state_dict(small.state_dict())
    assert large.input_size == 224
    assert large(torch.rand(1, 3, 224, 224)).shape == (1, 8, 112, 112)
