import json
from pathlib import Path

import torch

from posed_train.heatmap import Decode, SecondPeak, cell_centres
from posed_train.losses import heatmap_loss


def gaussian(u: float, v: float, sigma: float) -> torch.Tensor:
    centres = cell_centres(64, 2)
    return -0.5 * (((centres[None, :] - u) / sigma) ** 2 + ((centres[:, None] - v) / sigma) ** 2)


def test_decodes_a_gaussian():
    keypoints, covariances, peaks = Decode(64, 2)(gaussian(40.3, 77.8, 2.5)[None, None])
    assert torch.allclose(keypoints[0, 0], torch.tensor([40.3, 77.8]), atol=0.05)
    # A cell is 2 px wide, which adds nothing to the second moment of samples taken at its centre.
    assert torch.allclose(covariances[0, 0], 2.5**2 * torch.eye(2), atol=0.2)
    assert peaks[0, 0] > 0.99


def test_a_second_peak_leaves_the_mean_and_widens_the_covariance():
    logits = torch.logaddexp(gaussian(30.0, 30.0, 2.5), gaussian(90.0, 30.0, 2.5) - 1)
    keypoints, covariances, peaks = Decode(64, 2)(logits[None, None])
    assert torch.allclose(keypoints[0, 0], torch.tensor([30.0, 30.0]), atol=0.1)
    assert covariances[0, 0, 0, 0] > 500 and covariances[0, 0, 1, 1] < 20
    assert 0.6 < peaks[0, 0] < 0.85


def test_the_second_peak_is_where_the_rest_of_the_mass_is():
    two = torch.logaddexp(gaussian(30.3, 31.0, 2.5), gaussian(89.7, 30.0, 2.5) - 1)
    # A flank beyond the first window is no peak of its own, however high: this first peak is broad.
    broad = torch.logaddexp(gaussian(40.0, 40.0, 8.0), gaussian(100.0, 90.0, 2.5) - 4)
    keypoints, weights = SecondPeak(64, 2)(torch.stack([two, broad])[None])
    expected = torch.tensor([[89.7, 30.0], [100.0, 90.0]])
    torch.testing.assert_close(keypoints[0], expected, atol=0.2, rtol=0)
    assert torch.isclose(weights[0, 0], torch.tensor(-1.0).exp(), rtol=0.02)
    assert 0 < weights[0, 1] < 0.01


def test_without_a_second_peak_its_weight_is_nothing():
    keypoints, weights = SecondPeak(64, 2)(torch.stack([gaussian(40.3, 77.8, 2.5), 9 * gaussian(0.0, 0.0, 1.0)])[None])
    assert (weights < 1e-6).all() and keypoints.isfinite().all()


def test_loss_is_least_at_the_target_and_ignores_keypoints_outside():
    at = torch.tensor([[[[40.0, 77.0], [500.0, 10.0]]]])
    maps = lambda u, v: torch.stack([gaussian(u, v, 2.5), torch.randn(64, 64)])[None]  # noqa: E731
    right, wrong = heatmap_loss(maps(40.0, 77.0), at, 128), heatmap_loss(maps(48.0, 77.0), at, 128)
    assert right < wrong
    assert torch.isclose(right, heatmap_loss(maps(40.0, 77.0), at, 128)), "the second keypoint must not count"


def test_gradient_of_the_loss():
    logits = torch.randn(1, 2, 8, 8, dtype=torch.double, requires_grad=True)
    keypoints = torch.tensor([[[[3.0, 5.0], [9.5, 12.0]], [[9.0, 9.0], [4.0, 2.0]]]], dtype=torch.double)
    loss = lambda x: heatmap_loss(x, keypoints, 16, scale_weight=1.0)  # noqa: E731
    assert torch.autograd.gradcheck(loss, logits, atol=1e-5)


def test_a_common_scale_costs_more_than_errors_that_cancel():
    """The same distances, once all outwards and once by turns outwards and inwards."""
    corners = torch.tensor([[-30.0, -30.0], [30.0, -30.0], [30.0, 30.0], [-30.0, 30.0]])
    outwards, by_turns = 1.05 * corners, corners * torch.tensor([[1.05], [0.95], [1.05], [0.95]])

    def extra(found: torch.Tensor) -> float:
        """What the weight of the scale adds to the loss."""
        maps = torch.stack([gaussian(u, v, 2.5) for u, v in found + 64])[None]
        plain, weighted = (heatmap_loss(maps, corners[None, None] + 64, 128, scale_weight=w) for w in (0.0, 1.0))
        return float(weighted - plain)

    assert extra(outwards) > 1.0
    assert abs(extra(by_turns)) < 0.01


def test_a_symmetric_object_may_be_seen_either_way():
    """Both places of a keypoint cost the same alone; a mixture of both costs more."""
    ways = torch.tensor([[[[40.0, 77.0]], [[90.0, 30.0]]]])
    maps = lambda u, v: gaussian(u, v, 2.5)[None, None]  # noqa: E731
    either = heatmap_loss(maps(40.0, 77.0), ways, 128), heatmap_loss(maps(90.0, 30.0), ways, 128)
    assert torch.isclose(*either, atol=1e-3)
    assert heatmap_loss(torch.logaddexp(maps(40.0, 77.0), maps(90.0, 30.0)), ways, 128) > either[0] + 0.5


def test_parity_fixture_is_what_this_code_makes():
    """The Rust service decodes heatmaps of nets from elsewhere, and is tested against the same file."""
    path = Path(__file__).parents[2] / "tests" / "data" / "heatmaps.json"
    for case in json.loads(path.read_text()):
        side, input_px = case["side"], case["input_px"]
        logits = torch.tensor(case["logits"]).reshape(1, 1, side, side)
        keypoints, covariances, peaks = Decode(side, input_px / side)(logits)
        assert torch.allclose(keypoints[0, 0], torch.tensor(case["keypoint"]), atol=1e-4)
        assert torch.allclose(covariances[0, 0], torch.tensor(case["covariance"]), rtol=1e-4)
        assert torch.isclose(peaks[0, 0], torch.tensor(case["peak"]), atol=1e-5)
