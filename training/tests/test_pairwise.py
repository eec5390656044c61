"""The paper's losses on exact and on disturbed pairs of views."""

import torch

from posed_train import pairwise
from posed_train.keypoints import virtual_keypoints

KEYPOINTS = torch.tensor(virtual_keypoints("cube", 0.05, 8, 0))


def rotation(generator: torch.Generator) -> torch.Tensor:
    q, r = torch.linalg.qr(torch.randn(4, 3, 3, generator=generator, dtype=torch.double))
    q = q * torch.sign(torch.diagonal(r, dim1=-2, dim2=-1))[:, None]
    return q * torch.sign(torch.linalg.det(q))[:, None, None]


def pair(seed: int) -> tuple[torch.Tensor, ...]:
    """Four pairs of views of the keypoints: points in the first camera, both images, relative poses."""
    generator = torch.Generator().manual_seed(seed)
    points = KEYPOINTS @ rotation(generator).transpose(-1, -2) + torch.tensor([0.02, -0.03, 0.6])
    angle = torch.tensor([0.2, -0.3, 0.4, 0.5], dtype=torch.double)
    turn = torch.eye(4, dtype=torch.double).repeat(4, 1, 1)
    turn[:, 0, 0], turn[:, 0, 2], turn[:, 2, 0], turn[:, 2, 2] = angle.cos(), angle.sin(), -angle.sin(), angle.cos()
    turn[:, 0, 3], turn[:, 1, 3], turn[:, 2, 3] = -0.6 * angle.sin(), 0.02, 0.6 * (1 - angle.cos())
    in_second = points @ turn[:, :3, :3].transpose(-1, -2) + turn[:, None, :3, 3]
    return points, points[..., :2] / points[..., 2:], in_second[..., :2] / in_second[..., 2:], turn


def test_exact_views_give_the_points_and_no_loss():
    points, first, second, relative = pair(1)
    assert torch.allclose(pairwise.triangulate(first, second, relative), points, atol=1e-5)
    assert torch.allclose(pairwise.align(KEYPOINTS, points), points, atol=1e-9)
    assert pairwise.pairwise_loss(KEYPOINTS, first, second, relative) < 1e-2


def test_losses_see_what_they_should():
    points, first, second, relative = pair(2)
    # Moved along its epipolar line, a point is still consistent, but registration sees the wrong depth.
    deeper = points * 1.05
    in_second = deeper @ relative[:, :3, :3].transpose(-1, -2) + relative[:, None, :3, 3]
    shifted = second.clone()
    shifted[:, 0] = in_second[:, 0, :2] / in_second[:, 0, 2:]
    assert pairwise.consistency_loss(first, shifted, relative) < 1e-6
    assert pairwise.registration_loss(KEYPOINTS, pairwise.triangulate(first, shifted, relative)) > 1e-3
    # Moved across it, consistency sees it.
    across = second + torch.tensor([0.0, 0.01], dtype=torch.double)
    assert pairwise.consistency_loss(first, across, relative) > 1e-3


def test_a_mirror_image_is_no_alignment():
    points = pair(3)[0]
    mirrored = points * torch.tensor([1.0, -1.0, 1.0], dtype=torch.double)
    # A cube mirrored is a cube, with other corners: the keypoints have names.
    assert pairwise.registration_loss(KEYPOINTS, mirrored) > 0.01


def test_gradients():
    _, first, second, relative = pair(4)
    generator = torch.Generator().manual_seed(5)
    noise = 0.02 * torch.randn(first.shape, generator=generator, dtype=torch.double)
    inputs = ((first + noise).requires_grad_(), (second - noise.flip(1)).requires_grad_())
    assert torch.autograd.gradcheck(lambda a, b: pairwise.pairwise_loss(KEYPOINTS, a, b, relative), inputs, atol=1e-4)


def test_gradient_of_the_nearest_rotation_where_singular_values_are_alike():
    matrix = (2 * torch.eye(3, dtype=torch.double)[None]).requires_grad_()
    assert torch.autograd.gradcheck(pairwise.NearestRotation.apply, matrix)
