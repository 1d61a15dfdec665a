"""Checks annotated shapes and types in every call, each once; jaxtyping's own decorator checks parameters twice."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping._storage import pop_shape_memo, push_shape_memo

CONF = BeartypeConf(is_pep484_tower=True, violation_type=jaxtyping.TypeCheckError)
"""An int is a number wherever a float is asked for."""


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
    with_checks = beartype(conf=CONF)(function)
    if with_checks is function:  # nothing is annotated
        return function

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if jaxtyping.config.jaxtyping_disable:
            return function(*args, **kwargs)
        push_shape_memo({})
        try:
            return with_checks(*args, **kwargs)
        finally:
            pop_shape_memo()

    return call
