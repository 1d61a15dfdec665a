"""Annotated shapes are checked while tests run, and cost nothing while nobody asks."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
import pytest

import solver_backend
from solver_backend.cameras.robust_triangulation import Triangulation
from solver_backend.geometry.interpolation import slerp
from solver_backend.geometry.rotations import exp_so3, log_so3, quat_multiply
from solver_backend.metrics import mpjpe_mm

jaxtyping = pytest.importorskip("jaxtyping")
pytest.importorskip("beartype")
from jaxtyping import Bool, Float  # noqa: E402

from tests.support.annotation_checks import checked  # noqa: E402

KINDS = ["numpy", "torch"]
SHAPED = re.compile(r"\b(Float|Int|Bool)\[")


def zeros(kind: str, *shape: int) -> Any:
    return np.zeros(shape) if kind == "numpy" else pytest.importorskip("torch").zeros(*shape)


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_of_either_kind_pass(kind):
    assert exp_so3(zeros(kind, 5, 2, 3)).shape == (5, 2, 3, 3)
    assert quat_multiply(zeros(kind, 5, 1, 4), zeros(kind, 2, 4)).shape == (5, 2, 4)


@pytest.mark.parametrize("kind", KINDS)
def test_wrong_shapes_are_caught(kind):
    with pytest.raises(jaxtyping.TypeCheckError, match="parameter v="):
        exp_so3(zeros(kind, 5, 4))
    with pytest.raises(jaxtyping.TypeCheckError, match="parameter R="):
        log_so3(zeros(kind, 3, 4))
    with pytest.raises(jaxtyping.TypeCheckError, match="parameter b="):
        slerp(zeros(kind, 2, 3), zeros(kind, 5, 3), 0.5)


def test_sizes_that_numpy_would_broadcast_are_caught():
    with pytest.raises(jaxtyping.TypeCheckError, match="parameter truth="):
        mpjpe_mm(np.zeros((2, 3, 3)), np.zeros((1, 3, 3)))


def test_numbers_of_another_type_are_caught():
    with pytest.raises(jaxtyping.TypeCheckError, match="parameter v="):
        exp_so3(np.zeros((5, 3), dtype=int))


def test_the_fields_of_a_value_belong_together():
    found = Triangulation(
        np.zeros((5, 4, 3)), np.zeros((5, 4, 3, 3)), np.ones((2, 5, 4), bool), np.zeros((2, 5, 4)), np.ones(4)
    )
    assert found.of_keypoints(np.array([2, 0])).covariance.shape == (5, 2, 3, 3)
    with pytest.raises(jaxtyping.TypeCheckError, match="parameter covariance="):
        Triangulation(found.points[:, :3], found.covariance, found.inliers, found.residual_px, found.sigma_px)


def test_what_has_passed_before_is_checked_again_where_its_shapes_differ():
    def chosen(values: Float[np.ndarray, "n 1"], keep: Bool[np.ndarray, " n"]) -> Float[np.ndarray, "2 1"]:
        return values[keep]

    check, values = checked(chosen), np.zeros((3, 1))
    for _ in range(2):
        assert len(check(values, np.array([True, False, True]))) == 2
    with pytest.raises(jaxtyping.TypeCheckError, match="return"):
        check(values, np.array([True, True, True]))
    with pytest.raises(jaxtyping.TypeCheckError, match="parameter keep="):
        check(values, np.array([True, False]))
    with pytest.raises(jaxtyping.TypeCheckError, match="parameter keep="):
        check(values, np.array([1.0, 0.0, 1.0]))


Side = Literal["left", "right"]


def written(side: Side, *sizes: int, parts: tuple[int, ...] = (), rest: Any = None) -> str:
    return side * len(sizes)


def test_what_has_passed_before_is_checked_again_where_its_types_or_words_differ():
    check = checked(written)
    for size in (1, 2):
        assert check("left", size, 3, parts=(size,), rest=size) == "leftleft"
    for arguments, named in [
        (("up", 1, 2), {}),
        (("left", 1, "2"), {}),
        (("left", 1, 2), {"parts": ("1", "2")}),
        (("left", 1, 2), {"parts": [1]}),
    ]:
        with pytest.raises(jaxtyping.TypeCheckError):
            check(*arguments, **named)


def annotated() -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Yield every annotation with a shape in the solver, where it stands and the names it is read with."""
    for module in pkgutil.walk_packages(solver_backend.__path__, "solver_backend."):
        if "__main__" in module.name or ".training" in module.name:
            continue
        names = vars(importlib.import_module(module.name))
        for owner in list(names.values()):
            if getattr(owner, "__module__", "") != module.name:
                continue
            for item in (owner, *(vars(owner).values() if inspect.isclass(owner) else ())):
                for argument, text in getattr(item, "__annotations__", {}).items():
                    if isinstance(text, str) and SHAPED.search(text):
                        yield f"{module.name}.{getattr(item, '__qualname__', item)}, {argument}", text, names


def test_every_annotated_shape_can_be_read():
    """The checker passes over an annotation that it cannot read."""
    found = list(annotated())
    assert len(found) > 100
    for where, text, names in found:
        assert eval(text, names), where


def test_a_solve_does_not_import_the_checker():
    command = "import sys, solver_backend.cli.main, solver_backend.body.landmarks; print('jaxtyping' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", command], capture_output=True, text=True).stdout == "False\n"
