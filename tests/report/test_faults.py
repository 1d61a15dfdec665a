"""Faults in sentences: one for each camera and kind, stretches listed."""

from dataclasses import replace

import pytest

from solver_backend.cli.describe import describe_motion
from solver_backend.report.faults import fault_texts, faults_of
from solver_backend.types import Fault, FaultKind, Remedy
from tests.support.scenes import small_motion

LEGS = Fault(FaultKind.LIMBS_EXCHANGED, "cam_b", 30, 59, 88.5, Remedy.REPAIRED, "legs")


def test_stretches_of_one_camera_are_one_sentence():
    texts = fault_texts([LEGS, replace(LEGS, first=100, last=100), replace(LEGS, detail="arms")], 60.0)
    assert [t.what for t in texts] == [
        "Camera cam_b: left and right legs are exchanged in frames 30-59 (0.50 s), frame 100: put right.",
        "Camera cam_b: left and right arms are exchanged in frames 30-59 (0.50 s): put right.",
    ]
    assert not texts[0].bad and all(t.advice for t in texts)


@pytest.mark.parametrize("kind", list(FaultKind))
@pytest.mark.parametrize("remedy", list(Remedy))
def test_every_kind_has_words_and_survives_a_file(kind, remedy):
    fault = Fault(kind, "cam_b", 3, 9, 5.0, remedy, "legs")
    (text,) = fault_texts([fault], 60.0)
    assert (
        (
            "cam_b" in text.what
            or kind in (FaultKind.PERSON_AWAY, FaultKind.FRAMES_SKIPPED)
            or (kind.startswith("marker") and "legs" in text.what)
        )
        and "frames 3-9" in text.what
        and text.what.endswith(".")
    )
    assert Fault.from_dict(fault.as_dict()) == fault


def test_the_command_line_names_them():
    motion = replace(small_motion(), provenance={"findings": [LEGS.as_dict()]})
    assert faults_of(motion) == [LEGS]
    text, data = describe_motion(motion, 1.0)
    assert "found       Camera cam_b: left and right legs are exchanged in frames 30-59" in text
    assert data["findings"] == [LEGS.as_dict()]
