"""Points without names that ride on a bone: named as in the person's other takes, or left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.marker_names import name_markers
from solver_backend.body.markers import ON_BONE, marker_layout
from solver_backend.cli.describe_markers import describe_person
from solver_backend.cli.main import main
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.fitters.label_after import labelled_as_person
from solver_backend.fitters.label_first import labelled_capture
from solver_backend.fitters.marker_calibration.extra_names import named_extras, with_extras
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.io.markers.read import read_markers
from solver_backend.io.native.motion_file import write_subject
from solver_backend.labelling.outputs import MARKERS
from solver_backend.types import Capture, MarkerCloud, MarkerSubject
from tests.support.takes_in_pieces import pieces, shares
from tests.support.words import codes
from tests.support.worn_markers import worn_markers

KNOWN = marker_layout("CMU_41")
EXTRAS = ("LPAT", "RPAT", "LTTB", "LGTR", "LHFB", "LWRI")
BONES = {"LTTB": "LSHN", "LHFB": "LSHN", "LGTR": "LTHI"}
FRAMES = 80
"""Of two takes together, at 15 frames a second."""


@pytest.fixture(scope="module")
def worn() -> tuple[MarkerSubject, MarkerCloud]:
    """The person with the markers of the network's places alone, and all markers."""
    found = worn_markers((*KNOWN, *EXTRAS), FRAMES, fps=15.0, step=4)
    count = len(KNOWN)
    person = MarkerSubject(
        load_body().id, found.betas, KNOWN, KNOWN, found.offsets[:count], np.full(count, 0.005), np.full(count, np.nan)
    )
    return person, found.cloud


def take(cloud: MarkerCloud, frames: slice, seed: int) -> tuple[MarkerCloud, np.ndarray]:
    """Return a part of the take as the network leaves it, and each nameless point's marker among the extras."""
    part = replace(cloud, positions=cloud.positions[frames])
    bare, truth = pieces(part.columns([(cloud.labels or ()).index(label) for label in EXTRAS], EXTRAS), seed, 0.1)
    stray = np.random.default_rng(seed).uniform([-1, -1, 0], [1, 1, 2], (len(part.positions), 1, 3))
    known = part.positions[:, : len(KNOWN)]
    points = np.concatenate([known, bare.positions, stray], axis=1)
    names = (*KNOWN, *(f"*{k}" for k in range(points.shape[1] - len(KNOWN))))
    return MarkerCloud(points, cloud.fps, names), truth


def names_by_marker(cloud: MarkerCloud, named: MarkerCloud, truth: np.ndarray) -> dict[str, set[str]]:
    """Return the names that each extra's points have, empty where none."""
    found = {label: set[str]() for label in EXTRAS}
    points = cloud.positions[:, len(KNOWN) :]
    for label, column in zip(named.labels or (), np.moveaxis(named.positions, 1, 0), strict=True):
        for f in np.flatnonzero(np.isfinite(column).all(-1)):
            same = np.flatnonzero((points[f] == column[f]).all(-1))
            if same.size and same[0] < truth.shape[1]:
                found[EXTRAS[truth[f, same[0]]]].add("" if label.startswith("*") else label)
    return found


def test_an_extra_has_one_name_in_all_takes_of_a_person(worn: tuple[MarkerSubject, MarkerCloud]) -> None:
    person, cloud = worn
    body = load_body()
    first, truth_first = take(cloud, slice(0, 40), 1)
    second, truth_second = take(cloud, slice(40, 80), 2)
    learned = with_extras(person, [first, second], body)
    new = dict(zip(learned.labels[len(KNOWN) :], learned.places[len(KNOWN) :], strict=True))
    assert len(new) >= 4 and all(place.startswith(ON_BONE) for place in new.values())
    assert all("_X" in label and label not in MARKERS for label in new)
    one, two = (named_extras(c, learned, body) for c in (first, second))
    a = names_by_marker(first, one.cloud, truth_first)
    b = names_by_marker(second, two.cloud, truth_second)
    for label in EXTRAS:
        real = (a[label] | b[label]) - {""}
        assert len(real) <= 1, (label, a[label], b[label])
    assert sum(a[label] == b[label] != {""} for label in EXTRAS) >= 4
    assert not set.intersection(*({*a[label]} - {""} for label in ("LPAT", "LTTB")))
    for label, bone in BONES.items():
        assert all(name.startswith(bone) for name in a[label] - {""}), (label, a[label])


def test_a_person_of_strange_labels_names_what_the_network_named_otherwise(
    worn: tuple[MarkerSubject, MarkerCloud],
) -> None:
    """The network says LMT1 of this person's toe: they wear no such marker, and the point rides at their toe's."""
    person, cloud = worn
    strange = replace(person, labels=tuple(f"M{k}q" for k in range(len(KNOWN))))
    first, _ = take(cloud, slice(0, 40), 1)
    labels = tuple("LMT1" if label == "LTOE" else label for label in first.labels or ())
    network = replace(first, labels=labels)
    toe = first.positions[:, labels.index("LMT1")]
    body = load_body()
    found = named_extras(network, strange, body).cloud
    assert found.labels is not None and set(strange.labels) <= set(found.labels) and "LMT1" not in found.labels
    np.testing.assert_array_equal(found.positions[:, found.labels.index(strange.labels[KNOWN.index("LTOE")])], toe)
    kept = named_extras(network, strange, body, kept=("LMT1",)).cloud
    assert "LMT1" in (kept.labels or ()), "a name that the user assigned was changed"


def test_of_two_markers_as_near_none_is_chosen(worn: tuple[MarkerSubject, MarkerCloud]) -> None:
    person, cloud = worn
    body = load_body()
    first, _ = take(cloud, slice(0, 40), 1)
    learned = with_extras(person, [first], body)
    m = next(i for i, label in enumerate(learned.labels) if label.startswith("LSHN_X"))
    twin = replace(
        learned, labels=(*learned.labels, "twin"), places=(*learned.places, learned.places[m]),
        offsets=np.concatenate([learned.offsets, learned.offsets[[m]] + 0.004]),
        sigma_m=np.append(learned.sigma_m, 0.005), skin_m=np.append(learned.skin_m, np.nan),
    )  # fmt: skip
    found = named_extras(first, twin, body)
    assert not {"twin", learned.labels[m]} & set(found.cloud.labels or ()) and found.doubtful >= 1


def test_a_name_of_the_network_goes_to_the_point_that_had_it_before(worn: tuple[MarkerSubject, MarkerCloud]) -> None:
    """Of four markers on a thigh the network calls one LTHI, another one in each take."""
    person, cloud = worn
    body = load_body()
    first, _ = take(cloud, slice(0, 40), 1)
    learned = with_extras(person, [first], body)
    thigh, patella = (cloud.positions[40:, (cloud.labels or ()).index(label)] for label in ("LTHI", "LPAT"))
    points = cloud.positions[40:, : len(KNOWN)].copy()
    points[:, KNOWN.index("LTHI")] = patella
    network = MarkerCloud(np.concatenate([points, thigh[:, None]], axis=1), cloud.fps, (*KNOWN, "*0"))
    found = named_extras(network, learned, body).cloud
    labels = found.labels or ()
    np.testing.assert_array_equal(found.positions[:, labels.index("LTHI")], thigh)
    [other] = [label for label in labels if label not in KNOWN]
    np.testing.assert_array_equal(found.positions[:, labels.index(other)], patella)
    assert other in learned.labels
    kept = named_extras(network, learned, body, kept=("LTHI",)).cloud
    np.testing.assert_array_equal(kept.positions[:, (kept.labels or ()).index("LTHI")], patella)


def test_what_was_named_and_what_is_doubtful_is_reported(worn: tuple[MarkerSubject, MarkerCloud]) -> None:
    person, cloud = worn
    first, _ = take(cloud, slice(0, 40), 1)
    learned = with_extras(person, [first], load_body())
    farthest = describe_person(learned)[0].split("farthest")[1].split("from their named positions")[0]
    assert "_X" not in farthest, "a marker on a bone has no place of its name"
    unsure = diagnostic("points_not_named", extent="solve", percent=15.0)
    named = labelled_as_person(Capture("take", markers=first, problems=(unsure,)), learned)
    assert codes(named.notes) == ("points_named_of_person",)
    assert set(named.notes[0].where.markers) == set(learned.labels) - set(KNOWN)
    assert codes(named.problems) == (), "what the network left is named now"
    elsewhere = learned.offsets.copy()
    elsewhere[len(KNOWN) :] += 0.3
    other = labelled_as_person(Capture("take", markers=first, problems=(unsure,)), replace(learned, offsets=elsewhere))
    assert other.problems == (unsure,) and not other.notes


@pytest.mark.slow
def test_a_recording_with_clusters_is_named_after_the_person(shared_data: Path) -> None:
    """nimble Subject4: 29 markers within the network's places, 18 outside, of which it takes five for its own."""
    clouds = list[MarkerCloud]()
    for name in ("squats1", "walking1"):
        cloud = read_markers(shared_data / "markers" / "nimble" / "Subject4" / "MarkerData" / f"{name}.trc").cloud
        names = name_markers(cloud.labels or ())
        worn = [i for i, label in enumerate(cloud.labels or ()) if label in names.known or label in names.unknown]
        cloud = cloud.columns(worn, tuple((cloud.labels or ())[i] for i in worn))
        clouds.append(replace(cloud, positions=cloud.positions[::2][:300], fps=cloud.fps / 2, residual=None))
    person = calibrate_person([Capture("squats", markers=clouds[0])])
    bare, truth = pieces(clouds[1], 7)
    network, _ = labelled_capture(Capture("walk", markers=bare), always=True)
    found = labelled_as_person(network, person).markers
    assert found is not None
    which = np.full(truth.shape, -1)
    for column, label in enumerate(found.labels or ()):
        if label in (clouds[1].labels or ()):
            same = (bare.positions == found.positions[:, column, None]).all(-1)
            which[same] = (clouds[1].labels or ()).index(label)
    right, wrong = shares(which, truth)
    assert right >= 99.0 and wrong <= 0.5


def test_the_verb_writes_the_person_s_labels(worn: tuple[MarkerSubject, MarkerCloud], tmp_path: Path) -> None:
    person, cloud = worn
    learned = with_extras(person, [take(cloud, slice(0, 40), 1)[0]], load_body())
    strange = replace(learned, labels=tuple(f"M{k}q" for k in range(len(learned.labels))))
    write_subject(tmp_path / "person.npz", strange)
    bare = replace(cloud, positions=cloud.positions[40:], labels=tuple(f"*{k}" for k in range(len(cloud.labels or ()))))
    write_c3d(tmp_path / "bare.c3d", bare)
    out = tmp_path / "out.c3d"
    arguments = [
        "markers label",
        str(tmp_path / "bare.c3d"),
        "--subject",
        str(tmp_path / "person.npz"),
        "--out",
        str(out),
    ]
    assert main(arguments) == 0
    found = read_markers(out).cloud
    labels = found.labels or ()
    wrong = [
        label for k, label in enumerate(strange.labels[: len(KNOWN)])
        if label in labels and np.nanmax(np.abs(found.positions[:, labels.index(label)] - bare.positions[:, k])) > 1e-4
    ]  # fmt: skip
    assert not wrong and len(set(strange.labels) & set(labels)) >= 0.9 * len(strange.labels)
    assert main([*arguments, "--like", str(out), "--overwrite"]) != 0
