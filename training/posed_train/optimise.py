"""One step of gradient descent, and checkpoints: the same for keypoint nets and the detector."""

import copy
import ctypes
import math
import os
from collections.abc import Sequence
from itertools import compress
from pathlib import Path

import torch
from torch import Tensor, nn

WARM_UP_STEPS = 200
"""Or a fifth of a short training."""
MAX_GRADIENT_NORM = 5.0
AVERAGE_DECAY = 0.998
PARTS = ("model", "average", "optimizer")
# Of glibc's mallopt.
M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_MAX = -1, -2, -4
NEVER, AHEAD_BYTES = 2**31 - 1, 64 << 20


def learning_rate(peak: float, step: int, steps: int, cooling: tuple[int, int] | None = None) -> float:
    """Linear warm-up, then half a cosine down to zero. `cooling`, the first and the last step of it, ends it sooner."""
    if cooling is not None and step >= cooling[0]:
        first, last = cooling
        return learning_rate(peak, first, steps) * 0.5 * (1 + math.cos(math.pi * (step - first) / (last - first)))
    warm_up = min(WARM_UP_STEPS, steps // 5 + 1)
    return peak * min(1.0, (step + 1) / warm_up) * 0.5 * (1 + math.cos(math.pi * step / steps))


def keep_memory() -> None:
    """Lets this process keep what it has freed. glibc gives large blocks back to the system at once, and each step of a
    training on a CPU then waits for a quarter of a million pages to be zeroed anew: a sixth of its time."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # other C libraries have none
    if mallopt is not None:
        mallopt(M_MMAP_MAX, 0)
        mallopt(M_TRIM_THRESHOLD, NEVER)
        mallopt(M_TOP_PAD, AHEAD_BYTES)


def mixed_precision(device: torch.device, depthwise: bool = False) -> torch.autocast:
    """bfloat16 where it is faster. A CPU without instructions for it takes ten times as long as with floats, and with
    them for depthwise layers one and a half times."""
    known = torch.cpu.get_capabilities()
    fast_on_cpu = not depthwise and any(known.get(name) for name in ("amx_bf16", "avx512_bf16", "bf16"))
    return torch.autocast(device.type, torch.bfloat16, enabled=device.type != "cpu" or fast_on_cpu)


def freeze(module: nn.Module, parts: Sequence[str], normalisation: bool) -> None:
    """Holds the convolutions of these parts, and their normalisation, too, if so wanted."""
    modules = dict(module.named_modules())
    kinds = (nn.Conv2d, nn.BatchNorm2d) if normalisation else nn.Conv2d
    for part in parts:
        if part not in modules:
            known = ", ".join(name for name in modules if name and name.count(".") <= 2)
            raise ValueError(f"frozen {part!r}: the network has no such part; it has {known}, and parts of these")
        for layer in modules[part].modules():
            if isinstance(layer, kinds):
                layer.requires_grad_(False)


class Run:
    """A training in progress: everything that a checkpoint must hold. `slow` is a part that learns at a share of the
    rate."""

    def __init__(
        self, model: nn.Module, learning_rate: float, steps: int, slow: nn.Module | None = None, slow_share: float = 1.0
    ):
        self.model, self.peak, self.steps, self.step = model, learning_rate, steps, 0
        self.cooling: tuple[int, int] | None = None
        """First and last step, if it is to end sooner than planned."""
        self.average = copy.deepcopy(model)
        slow_ones = [] if slow is None else list(slow.parameters())
        known = {id(value) for value in slow_ones}
        groups = [([value for value in model.parameters() if id(value) not in known], 1.0), (slow_ones, slow_share)]
        groups = [(values, share) for values, share in groups if values]
        self.shares = [share for _, share in groups]
        self.optimizer = torch.optim.AdamW(
            [{"params": values} for values, _ in groups], lr=learning_rate, weight_decay=1e-4
        )

    @property
    def end(self) -> int:
        """The last step."""
        return self.steps if self.cooling is None else min(self.steps, self.cooling[1])

    def descend(self, loss: Tensor) -> float:
        """Applies one step and returns the loss; refuses a loss that is not finite before it can spoil the weights."""
        if not torch.isfinite(loss):
            raise FloatingPointError(f"step {self.step}: the loss is {loss.item()}; lower learning_rate and resume")
        for group, share in zip(self.optimizer.param_groups, self.shares):
            group["lr"] = share * learning_rate(self.peak, self.step, self.steps, self.cooling)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), MAX_GRADIENT_NORM)
        self.optimizer.step()
        self.step += 1
        follow(self.average, self.model, self.step)
        return loss.item()

    def save(self, path: Path) -> None:
        parts = {name: getattr(self, name).state_dict() for name in PARTS}
        save({"step": self.step, "cooling": self.cooling, **parts}, path)

    def resume(self, path: Path, device: torch.device) -> None:
        state = load(path, device, ("step", *PARTS))
        self.step, self.cooling = state["step"], state.get("cooling")
        for name in PARTS:
            try:
                getattr(self, name).load_state_dict(state[name])
            except (RuntimeError, ValueError, KeyError, TypeError, AttributeError):
                raise ValueError(
                    f"{path}: the checkpoint of another network; remove it, or its folder, to train anew"
                ) from None


@torch.no_grad()
def follow(average: nn.Module, model: nn.Module, step: int) -> None:
    """Moves the running average of the weights on; the average is what is validated and exported."""
    decay = min(AVERAGE_DECAY, (step + 1) / (step + 10))
    means, values = list(average.state_dict().values()), list(model.state_dict().values())
    floats = [mean.dtype.is_floating_point for mean in means]
    # All at once: on a GPU, a call for each of hundreds of weights takes longer than the step.
    torch._foreach_lerp_(list(compress(means, floats)), list(compress(values, floats)), 1 - decay)
    for mean, current, is_float in zip(means, values, floats):
        if not is_float:
            mean.copy_(current)


def load(path: Path, device: torch.device | str, needs: Sequence[str]) -> dict:
    """What `save` wrote, with these parts."""
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except OSError:
        raise
    except Exception as error:  # PyTorch lets through whatever unpickling meets
        raise ValueError(f"{path}: not a checkpoint, or a damaged one ({error})") from None
    if not isinstance(state, dict) or not set(needs) <= set(state):
        raise ValueError(f"{path}: not a checkpoint of posed-train's: it has no {', '.join(needs)}")
    return state


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
