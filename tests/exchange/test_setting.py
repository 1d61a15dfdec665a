"""A setting is declared once: its row checks values, and every place that takes settings takes all of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.setting import Setting, check_settings, defaults_of_class, setting, settings_of_class
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.verbs import VERBS

ROWS = settings_of_class(SolveSettings)


def test_every_field_is_a_setting_with_words_and_a_valid_default():
    assert list(ROWS) == list(SolveSettings.__dataclass_fields__)
    for name, row in ROWS.items():
        assert row.label and row.group and row.description[0].isupper() and not row.description.endswith("."), name
        default = defaults_of_class(SolveSettings)[name]
        assert row.accepts(default) or (name == "betas" and default is None), name


@pytest.mark.parametrize(("name", "row"), ROWS.items())
def test_the_ends_of_a_range_are_valid_and_what_lies_beyond_is_refused_by_name(name: str, row: Setting):
    bad: list[object] = [object(), float("nan")]
    if row.low is not None and row.high is not None:
        for end in (row.low, row.high):
            assert getattr(SolveSettings(**{name: type(defaults_of_class(SolveSettings)[name])(end)}), name) == end
        bad += [row.low - 1, row.high + 1, True, str(row.low), None]
    for choice in row.choices:
        assert getattr(SolveSettings(**{name: choice.value}), name) == choice.value
    for value in bad:
        with pytest.raises(JobInvalid, match=f"The setting {name} = ") as caught:
            replace(SolveSettings(), **{name: value})
        assert row.expected in caught.value.message and caught.value.where == name


@pytest.mark.parametrize("betas", [(0.0,) * 9, ("a",) * 10, (float("inf"),) * 10, "0123456789"])
def test_a_shape_is_ten_finite_numbers(betas):
    with pytest.raises(JobInvalid, match="a list of 10 numbers"):
        SolveSettings(betas=betas)


def test_a_dataclass_of_ones_own_is_checked_alike():
    @dataclass(frozen=True)
    class Toy:
        speed: float = setting("number", 1.0, "Speed", "How fast", group="Toy", low=0.5, high=2.0)

    check_settings(Toy(2))
    with pytest.raises(JobInvalid, match=r"The setting speed = 3 is not valid. It must be a number from 0\.5 to 2"):
        check_settings(Toy(3))


def test_settings_act_in_the_methods_they_declare():
    known = {choice.value for choice in ROWS["method"].choices}
    assert all(set(row.methods) <= known for row in ROWS.values())
    assert SolveSettings(method="frame", foot_lock=2.0, robust_scale=3.0).without_effect == ("foot_lock",)
    assert SolveSettings(window=8).without_effect == ("window",)


def test_a_number_that_no_float_holds_is_refused() -> None:
    assert not ROWS["window"].accepts(10**400)
    assert not ROWS["smoothing"].accepts(10**400)


def test_a_switch_is_also_turned_off_in_words() -> None:
    assert VERBS["solve"].words({"contacts": False, "window": 30}) == ["--no-contacts", "--window=30"]
