"""The paper's losses (section 3.2 and 3.3): two views with a known relative pose supervise each other.

All points are on the plane z = 1 of their cameras. `second_from_first` maps the first camera's frame to the second's.
"""

import torch
from torch import Tensor

REGISTRATION_WEIGHT = 100.0
CONSISTENCY_WEIGHT = 100.0
EPSILON = 1e-9


def triangulate(first: Tensor, second: Tensor, second_from_first: Tensor) -> Tensor:
    """Points `[B, N, 3]` in the first camera from their views `[B, N, 2]`: linear triangulation, each point by itself.

    Least squares of `x * (row 3) = (row 1)` and its like for y and the other camera, with the fourth coordinate 1.
    """
    rotation, translation = second_from_first[:, None, :3, :3], second_from_first[:, None, :3, 3]
    identity = torch.eye(3).to(first).expand_as(rotation)
    left, right = [], []
    for image, turn, shift in ((first, identity, torch.zeros_like(translation)), (second, rotation, translation)):
        for axis in (0, 1):
            coordinate = image[..., axis, None]
            left.append(coordinate * turn[..., 2, :] - turn[..., axis, :])
            right.append(shift[..., axis] - coordinate[..., 0] * shift[..., 2])
    matrix, constant = torch.stack(left, -2), torch.stack(right, -1)[..., None]
    transposed = matrix.transpose(-1, -2)
    # A little of the identity keeps parallel rays from being singular.
    normal = transposed @ matrix + EPSILON * torch.eye(3).to(first)
    return torch.linalg.solve(normal, transposed @ constant)[..., 0]


class NearestRotation(torch.autograd.Function):
    """The proper rotation nearest to each matrix `[B, 3, 3]`.

    Differentiating through the SVD divides by differences of singular values, which are all alike for a cube of
    keypoints. The rotation itself depends on their sums only.
    """

    @staticmethod
    def forward(ctx, matrix: Tensor) -> Tensor:
        u, s, vh = torch.linalg.svd(matrix)
        sign = torch.ones_like(s)
        sign[..., 2] = torch.sign(torch.linalg.det(u @ vh))
        rotation = u * sign[..., None, :] @ vh
        ctx.save_for_backward(rotation, s * sign, vh)
        return rotation

    @staticmethod
    def backward(ctx, gradient: Tensor) -> Tensor:
        rotation, s, vh = ctx.saved_tensors
        sums = s[..., :, None] + s[..., None, :]
        inner = vh @ rotation.transpose(-1, -2) @ gradient @ vh.transpose(-1, -2) / sums.clamp(min=EPSILON)
        return rotation @ vh.transpose(-1, -2) @ (inner - inner.transpose(-1, -2)) @ vh


def align(keypoints: Tensor, points: Tensor) -> Tensor:
    """`keypoints [N, 3]` moved rigidly onto `points [B, N, 3]` (Kabsch)."""
    from_centre, to_centre = keypoints.mean(0), points.mean(1, keepdim=True)
    correlation = (points - to_centre).transpose(-1, -2) @ (keypoints - from_centre)
    return (keypoints - from_centre) @ NearestRotation.apply(correlation).transpose(-1, -2) + to_centre


def registration_loss(keypoints: Tensor, points: Tensor) -> Tensor:
    """Mean distance (m) of the triangulated points from the virtual keypoints aligned with them."""
    return torch.linalg.norm(align(keypoints, points) - points, dim=-1).mean()


def consistency_loss(first: Tensor, second: Tensor, second_from_first: Tensor) -> Tensor:
    """Mean Sampson distance of the pairs from the epipolar constraint: the paper's `n2ᵀ [t]x R n1` as printed is
    signed, and its size depends on the baseline."""
    rotation, t = second_from_first[:, :3, :3], second_from_first[:, :3, 3]
    cross = torch.zeros_like(rotation)
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -t[:, 2], t[:, 1], -t[:, 0]
    essential = (cross - cross.transpose(-1, -2)) @ rotation
    one = torch.ones_like(first[..., :1])
    first, second = torch.cat([first, one], -1), torch.cat([second, one], -1)
    line_in_second, line_in_first = first @ essential.transpose(-1, -2), second @ essential
    error = (second * line_in_second).sum(-1)
    slope = line_in_second[..., :2].square().sum(-1) + line_in_first[..., :2].square().sum(-1)
    return (error.abs() / (slope + EPSILON).sqrt()).mean()


def pairwise_loss(
    keypoints: Tensor, first: Tensor, second: Tensor, second_from_first: Tensor, consistency: bool = True
) -> Tensor:
    """The paper's total: registration and consistency. With `consistency = False` registration alone."""
    loss = REGISTRATION_WEIGHT * registration_loss(keypoints, triangulate(first, second, second_from_first))
    if consistency:
        loss = loss + CONSISTENCY_WEIGHT * consistency_loss(first, second, second_from_first)
    return loss
