"""A device that is not there: tensors that say they lie elsewhere and refuse to meet those of the CPU, as real ones do.

Values lie on the CPU, so a whole solve can be checked for arrays that were made on the wrong side, without a GPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch.overrides import TorchFunctionMode

_MAY_MIX = ("aten::copy_", "aten::index", "aten::index_put_", "aten::index_put", "aten::_index_put_impl_")
"""Operations that take indices or values of the CPU beside tensors of a device."""


DEVICE = "cuda"  # What the tensors say; nothing of CUDA is started.

_ASKED_IN_C = tuple(
    getattr(torch.Tensor, name) for name in ("__invert__", "__float__", "__int__", "__bool__", "item", "tolist")
)
"""What torch's own code asks of the device's library, past what is intercepted here."""


class Elsewhere(torch.Tensor):
    """A tensor on the device that is not there."""

    held: torch.Tensor
    __module__ = "torch"  # Tensors are recognised by the module of their class.

    @staticmethod
    def __new__(cls, held: torch.Tensor) -> Elsewhere:
        made = torch.Tensor._make_wrapper_subclass(
            cls, held.size(), strides=held.stride(), storage_offset=held.storage_offset(), dtype=held.dtype,
            device=DEVICE,
        )  # fmt: skip
        made.held = held
        return made

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


class _Made(TorchFunctionMode):
    """Makes tensors that are asked for on the device here, and moves them there."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func in (torch.Tensor.__getitem__, torch.Tensor.__setitem__):
            return _pick(func, *args)
        if func in _ASKED_IN_C:
            return _run(func, args, kwargs)
        if str(kwargs.get("device")) != DEVICE:
            return func(*args, **kwargs)
        del kwargs["device"]
        if func is torch.asarray and isinstance(args[0], Elsewhere):
            return args[0].to(kwargs.get("dtype"))
        made = func(*args, **kwargs)
        return made if isinstance(made, Elsewhere) else Elsewhere(made)


@contextmanager
def another_device() -> Iterator[None]:
    """Let ``device=DEVICE`` name the device that is not there."""
    with _Made():
        yield


def _run(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    flat: list[torch.Tensor] = []
    _mapped(lambda x: flat.append(x) if isinstance(x, torch.Tensor) else None, (*args, *kwargs.values()))
    there = [x for x in flat if isinstance(x, Elsewhere)]
    here = [x for x in flat if not isinstance(x, Elsewhere) and x.ndim > 0]
    name = func.name().split(".")[0] if hasattr(func, "name") else func.__name__
    if here and (name not in _MAY_MIX or not isinstance(args[0], Elsewhere)) and name != "aten::copy_":
        raise RuntimeError(f"{name} met tensors of two devices: {[tuple(x.shape) for x in flat]}")
    leaves = name == "aten::_to_copy" and str(kwargs.get("device", DEVICE)) == "cpu"
    stays = isinstance(args[0], Elsewhere) if name == "aten::copy_" else not leaves
    kwargs = {key: _mapped(_inner, value) for key, value in kwargs.items() if key != "device"}
    out = func(*_mapped(_inner, args), **kwargs)
    kept = {id(x.held): x for x in there}
    return _mapped(lambda x: _outer(x, kept, stays) if isinstance(x, torch.Tensor) else x, out)


def _mapped(change: Callable[[Any], Any], value: Any) -> Any:
    """Return a value with everything in its lists and tuples changed; torch's ``tree_map`` takes half of a solve."""
    if isinstance(value, list | tuple):
        parts = [_mapped(change, part) for part in value]
        return parts if isinstance(value, list) else tuple(parts)
    return change(value)


def _outer(made: torch.Tensor, kept: dict[int, Elsewhere], stays: bool) -> torch.Tensor:
    if id(made) in kept:
        return kept[id(made)]
    return Elsewhere(made) if stays else made


def _pick(func: Any, tensor: torch.Tensor, index: Any, *value: Any) -> Any:
    """Index a tensor of either side; the device takes indices of the CPU, and the CPU none of the device."""
    parts = index if isinstance(index, tuple) else (index,)
    there = [isinstance(x, Elsewhere) for x in (*parts, *value)]
    if not isinstance(tensor, Elsewhere):
        if any(there):
            raise RuntimeError("a tensor of the CPU was indexed or filled from another device")
        return func(tensor, index, *value)
    if any(isinstance(x, torch.Tensor) and x.ndim > 0 and not isinstance(x, Elsewhere) for x in value):
        raise RuntimeError("a tensor of another device was filled from the CPU")
    out = func(tensor.held, tuple(map(_inner, parts)), *map(_inner, value))
    return None if out is None else Elsewhere(out)


def _inner(value: Any) -> Any:
    return value.held if isinstance(value, Elsewhere) else value
