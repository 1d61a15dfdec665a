"""Checks annotated shapes and types in every call, each once; jaxtyping's own decorator checks parameters twice."""

from __future__ import annotations

import dataclasses
import functools
import threading
from collections.abc import Callable, Collection, Hashable
from typing import Any

import jaxtyping
import numpy as np
from beartype import BeartypeConf, beartype
from jaxtyping._storage import pop_shape_memo, push_shape_memo

CONF = BeartypeConf(is_pep484_tower=True, violation_type=jaxtyping.TypeCheckError)
"""An int is a number wherever a float is asked for."""
_UNKNOWN = object()
"""Stands for what may hold anything, such as a list: it is checked in every call."""

_MOST = 500
"""Signatures that a function keeps; a name or number that differs in every call would fill the memory. By hand."""

_DEEPEST = 3
"""Tuples within tuples that are looked into: what a file holds may nest without end. By hand."""


def install(packages: list[str]) -> None:
    """Check every function and dataclass of these packages, which nothing has imported yet."""
    jaxtyping.install_import_hook(packages, "tests.support.annotation_checks.beartype")
    jaxtyping.jaxtyped = checked  # what jaxtyping's import hook puts before every function


def checked(decorated: Any = None, *, typechecker: object = None) -> Any:
    """Return a function, a property or a dataclass whose calls are checked; names of sizes hold within one call."""
    if decorated is None:
        return checked
    if isinstance(decorated, type):
        if dataclasses.is_dataclass(decorated):
            decorated.__init__ = _checked_function(decorated.__init__)
        return decorated
    if isinstance(decorated, classmethod | staticmethod):
        return type(decorated)(_checked_function(decorated.__func__))
    if isinstance(decorated, property):
        return property(*(f and _checked_function(f) for f in (decorated.fget, decorated.fset, decorated.fdel)))
    return _checked_function(decorated)


def _checked_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function whose calls are checked; what has the types and shapes of one that passed, by these alone."""
    shaped = any(map(_has_shape, function.__annotations__.values()))
    if not function.__annotations__ or ("<locals>" in function.__qualname__ and not shaped):
        return function  # what is defined within another is made ready in each of its calls, which costs more than it
    results: dict[int, Any] = {}

    @functools.wraps(function)
    def run_or_take(*args: Any, **kwargs: Any) -> Any:
        thread = threading.get_ident()
        return results.pop(thread) if thread in results else function(*args, **kwargs)

    with_checks = beartype(conf=CONF)(run_or_take)
    passed: set[Hashable] = set()

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if jaxtyping.config.jaxtyping_disable:
            return function(*args, **kwargs)
        given = _signature((*args, *kwargs.items()))
        if given in passed:
            result = function(*args, **kwargs)
            if (given, _signature(result)) in passed:
                return result
            results[threading.get_ident()] = result
        push_shape_memo({})
        try:
            result = with_checks(*args, **kwargs)
        finally:
            pop_shape_memo()
        if given is not _UNKNOWN and len(passed) < _MOST:
            found = _signature(result)
            passed.update([given] if found is _UNKNOWN else [given, (given, found)])
        return result

    return call


def _has_shape(annotation: Any) -> bool:
    return "[" in str(annotation) and any(name in str(annotation) for name in ("Float", "Int", "Bool"))


def _signature(value: Any, depth: int = 0) -> Hashable:
    """Return all that a check of a value depends on: types, shapes, names; _UNKNOWN where that is not known."""
    kind = type(value)
    if kind is np.ndarray:
        return value.dtype.char, value.shape
    if kind is str or kind is int or kind is bool or kind is type:
        return kind, value
    if kind is tuple:
        if depth == _DEEPEST:
            return _UNKNOWN
        parts = tuple(_signature(part, depth + 1) for part in value)
        return _UNKNOWN if _UNKNOWN in parts else parts
    if hasattr(value, "dtype") and isinstance(shape := getattr(value, "shape", None), tuple):  # a scalar, a tensor
        return kind, str(value.dtype), tuple(shape)
    return _UNKNOWN if issubclass(kind, Collection) else kind
