"""Results that are surely useless are refused, unless the user accepts the fault by its code."""

from __future__ import annotations

import pytest

from solver_backend.exchange.diagnostics import Severity, diagnostic, list_refusals, refuse_errors
from solver_backend.exchange.errors import JobInvalid, ResultRefused
from solver_backend.exchange.solve_settings import SolveSettings

TALL = diagnostic("stature_odd", size=5.78, least=0.65, most=2.8)
APART = diagnostic("views_contradict", cameras=["cam01", "cam03"], percent=50.0)


def test_an_error_is_refused_with_what_to_do() -> None:
    with pytest.raises(ResultRefused, match=r"5\.78 m tall") as caught:
        refuse_errors([TALL, APART], (), "take")
    hint = caught.value.hint
    assert "--stature" in hint and "cam01, cam03" in hint and caught.value.where == "take"
    assert "--accept stature_odd --accept views_contradict" in hint


def test_an_accepted_error_is_a_warning_and_the_others_are_refused() -> None:
    (kept,) = refuse_errors([TALL], ["stature_odd"], "take")
    assert kept.severity is Severity.WARNING and kept.values == TALL.values
    with pytest.raises(ResultRefused) as caught:
        refuse_errors([TALL, APART], ["stature_odd"], "take")
    assert "5.78" not in caught.value.message


def test_warnings_pass() -> None:
    odd = diagnostic("stature_odd", severity=Severity.WARNING, size=1.1, least=1.2, most=2.2)
    assert refuse_errors([odd], (), "take") == (odd,)


def test_codes_that_refuse_nothing_are_named() -> None:
    assert SolveSettings(accept=list_refusals()).accept == list_refusals()
    with pytest.raises(JobInvalid, match="There is no error to accept with the code stature") as caught:
        SolveSettings(accept=("stature",))
    assert "stature_odd" in caught.value.hint


def test_a_refusal_repeats_what_the_reader_doubted() -> None:
    doubt = diagnostic("scene_message", text="The joint set is not certain.")
    with pytest.raises(ResultRefused) as caught:
        refuse_errors([doubt, TALL, APART], (), "take")
    assert caught.value.hint.startswith("Earlier warnings may explain it: The joint set is not certain.")
