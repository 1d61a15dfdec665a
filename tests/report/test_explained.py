"""A camera whose fault is corrected is named once: by what was wrong with it."""

from __future__ import annotations

import pytest

from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.report.checks import without_explained
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture

DOUBTS = [
    diagnostic("camera_sees_elsewhere", cameras=["cam03"]),
    diagnostic("cameras_shifted", cameras=["cam01", "cam03"], shifts={"cam01": 20, "cam03": 215}),
    diagnostic("scene_message", text="The views have different frame rates."),
]


def corrected(last: int, remedy: Remedy = Remedy.REPAIRED) -> Diagnostic:
    return diagnostic("image_mirrored", cameras=["cam03"], frames=[(0, last)], remedy=remedy)


def test_only_the_explanation_stays() -> None:
    found = list(without_explained([*DOUBTS, corrected(99)], 100))
    assert found[0] == diagnostic("cameras_shifted", cameras=["cam01"], shifts={"cam01": 20})
    assert [item.code for item in found[1:]] == ["scene_message", "image_mirrored"]
    shifted = diagnostic("cameras_shifted", cameras=["cam03"], shifts={"cam03": 30})
    alone = list(without_explained([DOUBTS[0], shifted, corrected(99)], 100))
    assert [item.code for item in alone] == ["image_mirrored"]


def test_what_was_compared_with_a_corrected_camera_is_no_doubt_of_the_others() -> None:
    """Three phones, one a mirror: the two others seemed shifted against it, and all lenses too long."""
    cameras, keypoints = demo_capture(30).require_multiview()
    lenses = diagnostic("focal_lengths_off", cameras=cameras.names[1:], percent=14.0, way="long")
    three = Capture(
        "three", cameras=cameras.subset([1, 2, 3]), keypoints=keypoints.views([1, 2, 3]), footage=(None,) * 3
    )
    assert [i.code for i in without_explained([*DOUBTS, lenses, corrected(99)], 100, three)] == [
        "scene_message", "image_mirrored"
    ]  # fmt: skip
    assert list(without_explained([*DOUBTS, lenses], 100, three)) == [*DOUBTS, lenses]
    four = Capture("four", cameras=cameras, keypoints=keypoints, footage=(None,) * 4)
    assert [i.code for i in without_explained([DOUBTS[1], corrected(99)], 100, four)] == [
        "cameras_shifted", "image_mirrored"
    ]  # fmt: skip


@pytest.mark.parametrize(
    "item", [corrected(50), corrected(99, Remedy.REPORTED)], ids=["half the take", "reported alone"]
)
def test_what_is_not_corrected_throughout_is_still_doubted(item: Diagnostic) -> None:
    assert list(without_explained([*DOUBTS, item], 100)) == [*DOUBTS, item]


def test_a_camera_that_moved_during_the_take_has_no_unknown_fault() -> None:
    unknown = diagnostic("camera_unexplained", cameras=["cam03"])
    moved = diagnostic("camera_turned", cameras=["cam03"], frames=[(50, 99)], remedy=Remedy.REPAIRED, size=10.0)
    assert list(without_explained([unknown, moved], 100)) == [moved]
    other = diagnostic("camera_unexplained", cameras=["cam01"])
    assert list(without_explained([other, moved], 100)) == [other, moved]


def test_a_second_correction_in_part_of_the_take_brings_no_doubt_back() -> None:
    moved = diagnostic("camera_turned", cameras=["cam03"], frames=[(50, 99)], remedy=Remedy.REPAIRED, size=10.0)
    assert list(without_explained([DOUBTS[0], corrected(99), moved], 100)) == [corrected(99), moved]
