"""A marker that is one in one take and another in the next is noticed, left out and reported."""

from __future__ import annotations

from dataclasses import replace

import pytest

from solver_backend.body.markers import marker_layout
from solver_backend.cli.describe_markers import describe_person
from solver_backend.fitters.marker_calibration.person_doubts import doubts_of
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.types import Capture, MarkerCloud
from tests.support.worn_markers import worn_markers

LABELS = (*marker_layout("CMU_41"), "LFSH", "LBSH", "T4")


@pytest.fixture(scope="module")
def takes() -> tuple[MarkerCloud, MarkerCloud]:
    """Return two takes of one person, half a walk each."""
    cloud = worn_markers(LABELS, 80, fps=30.0, step=2).cloud
    one, two = (replace(cloud, positions=part) for part in (cloud.positions[:40], cloud.positions[40:]))
    return one, two


def as_seen(cloud: MarkerCloud, names: dict[str, str]) -> MarkerCloud:
    """Return the 41 labels of a take, some of them on other markers."""
    labels = [label for label in marker_layout("CMU_41") if label != "LSHO"] + ["LSHO"]
    columns = [LABELS.index(names.get(label, label)) for label in labels]
    return cloud.columns(columns, tuple(labels))


@pytest.mark.slow
def test_front_and_back_shoulder_with_one_name_are_noticed(takes):
    one, two = as_seen(takes[0], {"LSHO": "LFSH"}), as_seen(takes[1], {"LSHO": "LBSH", "C7": "T4"})
    person = calibrate_person([Capture("one", markers=one), Capture("two", markers=two)])
    assert not {"LSHO", "C7"} & set(person.labels) and len(person.labels) == 39
    (found,) = [item for item in doubts_of(person) if item.code == "marker_in_two_places"]
    assert set(found.where.markers) == {"LSHO", "C7"}
    text, data = describe_person(person)
    assert "mm between takes 1 and 2" in text and data["diagnostics"][0]["code"] == "marker_in_two_places"


@pytest.mark.slow
def test_takes_that_agree_keep_every_marker(takes):
    clouds = [as_seen(take, {}) for take in takes]
    person = calibrate_person([Capture(f"take {k}", markers=cloud) for k, cloud in enumerate(clouds)])
    assert len(person.labels) == 41 and not doubts_of(person)
