"""A camera whose fault is corrected is named once: by what was wrong with it."""

from __future__ import annotations

import pytest

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.diagnostics.diagnostic import Diagnostic, Remedy
from solver_backend.io.recognition.world_check import SHIFTED
from solver_backend.people.person_selection import ELSEWHERE
from solver_backend.report.explained import without_explained

DOUBTS = [
    diagnostic("earlier_warning", text=f"Camera cam03 {ELSEWHERE}: it may be turned, mirrored."),
    diagnostic(
        "earlier_warning", text=f"{SHIFTED}: cam01 by 20 px, cam03 by 215 px. Their calibration is a little off."
    ),
    diagnostic("earlier_warning", text="The views have different frame rates."),
]


def corrected(last: int, remedy: Remedy = Remedy.REPAIRED) -> Diagnostic:
    return diagnostic("image_mirrored", cameras=["cam03"], frames=[(0, last)], remedy=remedy)


def test_only_the_explanation_stays() -> None:
    found = list(without_explained([*DOUBTS, corrected(99)], 100))
    assert [item.values.get("text") for item in found] == [
        f"{SHIFTED}: cam01 by 20 px. Their calibration is a little off.", "The views have different frame rates.", None,
    ]  # fmt: skip
    alone = list(
        without_explained(
            [DOUBTS[0], diagnostic("earlier_warning", text=f"{SHIFTED}: cam03 by 30 px. A."), corrected(99)], 100
        )
    )
    assert [item.code for item in alone] == ["image_mirrored"]


@pytest.mark.parametrize(
    "item", [corrected(50), corrected(99, Remedy.REPORTED)], ids=["half the take", "reported alone"]
)
def test_what_is_not_corrected_throughout_is_still_doubted(item: Diagnostic) -> None:
    assert list(without_explained([*DOUBTS, item], 100)) == [*DOUBTS, item]
