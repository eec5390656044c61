"""One step of gradient descent, and checkpoints: the same for keypoint nets and the detector."""

import math
import os
from pathlib import Path

import torch
from torch import Tensor, nn

WARM_UP_STEPS = 200
MAX_GRADIENT_NORM = 5.0
AVERAGE_DECAY = 0.998


def learning_rate(peak: float, step: int, steps: int) -> float:
    """Linear warm-up, then half a cosine down to zero."""
    return peak * min(1.0, (step + 1) / WARM_UP_STEPS) * 0.5 * (1 + math.cos(math.pi * step / steps))


def descend(model: nn.Module, optimizer: torch.optim.Optimizer, loss: Tensor, rate: float, step: int) -> float:
    """Applies one step and returns the loss; refuses a loss that is not finite before it can spoil the weights."""
    if not torch.isfinite(loss):
        raise FloatingPointError(f"step {step}: the loss is {loss.item()}; lower learning_rate and resume")
    for group in optimizer.param_groups:
        group["lr"] = rate
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(model.parameters(), MAX_GRADIENT_NORM)
    optimizer.step()
    return loss.item()


@torch.no_grad()
def follow(average: nn.Module, model: nn.Module, step: int) -> None:
    """Moves the running average of the weights on; the average is what is validated and exported."""
    decay = min(AVERAGE_DECAY, (step + 1) / (step + 10))
    for mean, current in zip(average.state_dict().values(), model.state_dict().values()):
        if mean.dtype.is_floating_point:
            mean.lerp_(current, 1 - decay)
        else:
            mean.copy_(current)


def save(state: dict, path: Path) -> None:
    """A reader sees the old checkpoint or the new one, never a part."""
    temporary = path.with_suffix(".tmp")
    try:
        torch.save(state, temporary)
    except (OSError, RuntimeError) as error:  # PyTorch reports a full disk as a RuntimeError
        temporary.unlink(missing_ok=True)
        raise OSError(
            f"{path}: cannot write the checkpoint ({error}); is the disk full? The last one is kept"
        ) from None
    os.replace(temporary, path)
