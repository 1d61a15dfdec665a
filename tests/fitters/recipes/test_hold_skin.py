"""Which surfaces the skin stays outside of, if the measurements contradict some of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from solver_backend.fitters.recipes import bundle as recipe
from solver_backend.geometry.obstacles import Obstacles


@dataclass(frozen=True)
class Take:
    """A bundle without measurements."""

    problem: Any
    settings: Any = None
    skin: Any = None
    notes: tuple[Any, ...] = ()
    data_cost: float = 0.0


@pytest.mark.parametrize(
    ("wrong", "used", "named"),
    [
        ("", "objects floor people", []),
        ("people", "objects floor", ["other people"]),
        ("objects", "floor people", ["objects"]),
        ("objects people", "floor", ["objects", "other people"]),
        ("objects floor", "people", ["floor and objects"]),
        ("objects floor people", "", ["floor and objects", "other people"]),
    ],
)
def test_only_contradicted_surfaces_are_given_up(
    wrong: str, used: str, named: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def hold_outside(take: Take, surfaces: Obstacles, people: object) -> tuple[Take, np.ndarray]:
        has_floor = np.isfinite(surfaces.nearest(np.zeros((1, 1, 3)), 0.1)[0]).all()
        kept = ["objects"] * surfaces.has_objects + ["floor"] * bool(has_floor) + ["people"] * (people is not None)
        return replace(take, skin=kept, data_cost=float(any(name in kept for name in wrong.split()))), np.zeros(1)

    seat = Obstacles(Obstacles.floor().planes, (np.array([[[3.0, 3.0, 0.5], [4.0, 3.0, 0.5], [4.0, 4.0, 0.5]]]),))
    monkeypatch.setattr(recipe, "holds_skin", lambda problem, settings: True)
    monkeypatch.setattr(recipe, "world_of", lambda settings: seat)
    monkeypatch.setattr(recipe, "_hold_outside", hold_outside)
    monkeypatch.setattr(recipe, "contradicts", lambda works, rise: rise > 0.0)
    take: Any = Take(SimpleNamespace(others=object()))
    found: Any = recipe.hold_skin(take)
    assert (found.skin or []) == used.split()
    assert [note.values["surface"] for note in found.notes] == named
