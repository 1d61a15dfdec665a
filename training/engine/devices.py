"""Where a network is trained: the processor, or a graphics processor that speaks CUDA."""

from __future__ import annotations

import torch
from torch import nn

from solver_backend.exchange.errors import BackendMissing, JobInvalid

DEVICES = ("cpu", "cuda")


def check_device(name: str) -> None:
    """Make sure that this machine can train there.

    Raises:
        JobInvalid: no device of that name is known.
        BackendMissing: torch finds no CUDA device.
    """
    if name not in DEVICES:
        raise JobInvalid(f"There is no device {name!r} (known: {', '.join(DEVICES)}).", where="device")
    if name == "cuda" and not torch.cuda.is_available():
        raise BackendMissing(
            "Training on cuda was asked for, and torch finds no CUDA device.", where="device",
            hint="Train with --device cpu, or install a driver and a torch build for CUDA.",
        )  # fmt: skip


def device_of(model: nn.Module) -> torch.device:
    """Return where a network's parameters are."""
    return next(model.parameters()).device


def dropout_state(device: str) -> torch.Tensor:
    """Return the state of the generator that dropout draws from on a device."""
    return torch.get_rng_state() if device == "cpu" else torch.cuda.get_rng_state()


def set_dropout_state(device: str, state: torch.Tensor) -> None:
    """Go on drawing from a state."""
    if device == "cpu":
        torch.set_rng_state(state)
    else:
        torch.cuda.set_rng_state(state)
