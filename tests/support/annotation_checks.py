"""Checks annotated shapes and types of calls, each once; jaxtyping's own decorator checks parameters twice.

Of a function that a test calls often, the first calls are checked and then one in some: see ``_ALL_UNTIL``.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import threading
from collections.abc import Callable, Collection, Hashable
from typing import Any

import jaxtyping
import numpy as np
from beartype import BeartypeConf, beartype
from jaxtyping._storage import pop_shape_memo, push_shape_memo

CONF = BeartypeConf(is_pep484_tower=True, violation_type=jaxtyping.TypeCheckError)
"""An int is a number wherever a float is asked for."""
_ARRAY = np.ndarray  # Looked for in every argument.
_UNKNOWN = object()  # Stands for what may hold anything, such as a list: it is checked in every call.

_MOST = 500
"""Signatures that a function keeps; a name or number that differs in every call would fill the memory. By hand."""

_ALL_UNTIL = (
    64  # Calls of a function in one test of which each is checked. A check costs as much as a small function. By hand.
)
_ONE_IN = 16  # Of later calls, one in so many is checked. By hand.

_DEEPEST = 3  # Tuples within tuples that are looked into: what a file holds may nest without end. By hand.


class _Test:
    """The test that runs."""

    number = 0  # Rises with each test, whose calls are counted from zero.


def begin_test() -> None:
    """Count the calls of each function from zero."""
    _Test.number += 1


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

    # Made ready by the first call, which many functions never see.
    with_checks: Callable[..., Any] | None = None
    all_places = of_result = _all_at_once([])
    by_name: dict[str, Look] = {}
    by_place, of_rest = list[Look](), _nothing
    passed: dict[Hashable, set[Hashable]] = {}  # what results of arguments that passed looked like
    config = jaxtyping.config
    test = calls = 0

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal with_checks, all_places, of_result, by_name, by_place, of_rest, test, calls
        if test != _Test.number:
            test, calls = _Test.number, 0
        calls += 1
        if (calls > _ALL_UNTIL and calls % _ONE_IN) or config.jaxtyping_disable:
            return function(*args, **kwargs)
        if with_checks is None:
            by_place, by_name, look_at_result = _looks(function)
            of_rest = by_name.get("*", _nothing)
            all_places, of_result = _all_at_once(by_place), _all_at_once([look_at_result])
            with_checks = beartype(conf=CONF)(run_or_take)
        if kwargs or len(args) != len(by_place):
            parts: list[Hashable] = [look(value) for look, value in zip(by_place, args, strict=False)]
            if len(args) > len(by_place):
                parts += map(of_rest, args[len(by_place) :])
            for name, value in kwargs.items():
                parts += name, by_name.get(name, _exact)(value)
            given = tuple(parts)
        else:
            given = all_places(*args)
        results_of = passed.get(given)
        if results_of is not None:
            result = function(*args, **kwargs)
            if of_result(result) in results_of:
                return result
            results[threading.get_ident()] = result
        push_shape_memo({})
        try:
            result = with_checks(*args, **kwargs)
        finally:
            pop_shape_memo()
        if _UNKNOWN not in given and len(passed) < _MOST:
            found = of_result(result)
            passed.setdefault(given, set()).update(() if _UNKNOWN in found else (found,))
        return result

    return call


def _has_shape(annotation: Any) -> bool:
    return "[" in str(annotation) and any(name in str(annotation) for name in ("Float", "Int", "Bool"))


def _all_at_once(looks: list[Look]) -> Callable[..., tuple[Hashable, ...]]:
    """Return a function that looks at one value each; arrays, which most are, are looked at without a further call."""
    shapes = [look is _exact for look in looks]

    def look_at(*values: Any) -> tuple[Hashable, ...]:
        return tuple([
            (value.dtype.char, value.shape) if shaped and type(value) is _ARRAY else look(value)
            for look, shaped, value in zip(looks, shapes, values, strict=True)
        ])  # fmt: skip

    return look_at


Look = Callable[[Any], Hashable]
"""Returns all of a value that the check against one annotation depends on; _UNKNOWN where that is not known."""


def _looks(function: Callable[..., Any]) -> tuple[list[Look], dict[str, Look], Look]:
    """Return how to look at each argument by its place and by its name (``*`` for several), and at the result."""
    resolved = {name: _resolved(hint, function) for name, hint in function.__annotations__.items()}
    by_value = any("{" in repr(hint) for hint in resolved.values())  # sizes that other arguments' values give
    looks = {name: _exact if by_value else _look(hint) for name, hint in resolved.items()}
    parameters = inspect.signature(function).parameters.values()
    positional = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    several = {p.name: "*" for p in parameters if p.kind is p.VAR_POSITIONAL}
    named = [p.name for p in parameters if p.kind is not p.VAR_KEYWORD]
    by_name = {several.get(name, name): looks.get(name, _nothing) for name in named}
    return [by_name[name] for name in positional], by_name, looks.get("return", _nothing)


def _resolved(annotation: Any, function: Callable[..., Any]) -> Any:
    """Return what an annotation stands for; None where a name in it is not there yet."""
    try:
        return eval(annotation, function.__globals__) if isinstance(annotation, str) else annotation
    except (NameError, TypeError):
        return None


def _look(hint: Any) -> Look:
    """Return how to look at a value of this annotation; a word counts where only some are allowed."""
    if hint is Any or hint is object:
        return _nothing
    text = repr(hint)
    return _exact if hint is None or "jaxtyping" in text or "Literal" in text else _kinds


def _nothing(value: Any) -> Hashable:
    return None


def _exact(value: Any, depth: int = 0) -> Hashable:
    """Return types, shapes and words of a value."""
    kind = type(value)
    if kind is _ARRAY:
        return value.dtype.char, value.shape
    if kind is str or kind is int or kind is bool:
        return kind, value
    if hasattr(value, "dtype") and isinstance(shape := getattr(value, "shape", None), tuple):  # a scalar, a tensor
        return kind, str(value.dtype), tuple(shape)
    return _of_others(value, kind, _exact, depth)


def _kinds(value: Any, depth: int = 0) -> Hashable:
    """Return types alone, and of an array that of its numbers."""
    kind = type(value)
    if kind is _ARRAY:
        return value.dtype.char
    if kind is str or kind is int or kind is bool:
        return kind
    if kind is tuple and len(kinds := set(map(type, value))) == 1 and _is_plain(*kinds):
        return tuple, kinds.pop(), len(value)
    return _of_others(value, kind, _exact, depth)


def _of_others(value: Any, kind: type, look: Callable[[Any, int], Hashable], depth: int) -> Hashable:
    if kind is type:
        return kind, value
    if kind is tuple:
        if depth == _DEEPEST:
            return _UNKNOWN
        parts = tuple([look(part, depth + 1) for part in value])
        return _UNKNOWN if _UNKNOWN in parts else parts
    return _UNKNOWN if _is_collection(kind) else kind  # of a tensor too, where its shape does not count


@functools.cache
def _is_plain(kind: type) -> bool:
    """Return whether values of a class have no parts; of several that have the same class one stands for all."""
    return kind is str or not (kind in (np.ndarray, type) or _is_collection(kind))


@functools.cache
def _is_collection(kind: type) -> bool:
    return issubclass(kind, Collection) and not hasattr(kind, "dtype")
