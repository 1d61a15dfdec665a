"""Files of markers as captures: what is read, what is said, and what is refused by name."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.markers import marker_layout
from solver_backend.exchange.errors import FileDamaged, JobInvalid, MarkersUnknown, NoDetections, TakeTooShort
from solver_backend.fitters import SolveSettings, solve
from solver_backend.io.load import load_capture
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.io.markers.camera_systems import write_trc
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.recognition.marker_labels import by_subject
from solver_backend.types import MarkerCloud
from tests.support.skeleton_labels import SUIT
from tests.support.words import words
from tests.support.worn_markers import worn_markers

LABELS = marker_layout("PLUGIN_GAIT_39")


@pytest.fixture(scope="module")
def cloud() -> MarkerCloud:
    return worn_markers(LABELS, 12, step=4).cloud


def with_points(cloud: MarkerCloud, *labels: str) -> MarkerCloud:
    """Return the cloud with points at places of other markers, under these labels."""
    positions = np.concatenate([cloud.positions, cloud.positions[:, : len(labels)] + 0.01], axis=1)
    return replace(cloud, positions=positions, labels=(*(cloud.labels or ()), *labels))


def test_every_marker_is_in_the_capture_and_what_is_left_out_is_said(tmp_path, cloud):
    path = write_c3d(tmp_path / "take.c3d", with_points(cloud, "LHJC", "thigh_cluster_1", "LFWT", "*3"))
    capture = load_capture(path)
    assert capture.keypoints is None and capture.cameras is None and capture.markers is not None
    assert capture.markers.positions.shape == (12, 43, 3) and capture.fps == 60.0 and capture.name == "take"
    notes = " ".join(words(capture.notes))
    for said in (
        "Lengths are in mm", "Z points up",
        "Labels that are not in any known layout (1): thigh_cluster_1",
        "computed points (1), LHJC", "duplicate points of a body part (1), LFWT",
        "points without names (1), *3",
    ):  # fmt: skip
        assert said in notes
    assert capture.problems == ()


def test_markers_of_hands_are_called_so_and_a_single_label_of_one_is_not(tmp_path, cloud):
    hand = ("L_FT1", "L_FT2", "L_MP2", "L_MP5")
    notes = {note.code: note for note in load_capture(write_c3d(tmp_path / "a.c3d", with_points(cloud, *hand))).notes}
    assert notes["labels_of_hands"].values == {"left": 4, "right": 0}
    assert "labels_of_no_layout" not in notes
    notes = {note.code: note for note in load_capture(write_c3d(tmp_path / "b.c3d", with_points(cloud, "L_FT1"))).notes}
    assert notes["labels_of_no_layout"].where.markers == ("L_FT1",) and "labels_of_hands" not in notes


def test_options_reach_the_reader_and_own_files_keep_the_markers(tmp_path, cloud):
    path = write_trc(tmp_path / "take.trc", cloud, unit="cm", up_axis="y")
    capture = load_capture(path, fps=120.0, unit="cm", up_axis="y")
    assert capture.markers is not None and capture.fps == 120.0
    np.testing.assert_allclose(capture.markers.positions, cloud.positions, atol=1e-5)
    again = load_capture(write_capture(tmp_path / "take.npz", capture), fps=100.0)
    assert again.markers is not None and again.fps == 100.0 and again.markers.labels == LABELS
    np.testing.assert_allclose(again.markers.positions, cloud.positions, atol=1e-5)


def test_millimetres_told_as_metres_are_a_problem_and_read_right(tmp_path, cloud):
    text = write_trc(tmp_path / "take.trc", cloud).read_text(encoding="utf-8")
    (tmp_path / "wrong.trc").write_text(text.replace("\tmm\t", "\tm\t", 1), encoding="utf-8")
    capture = load_capture(tmp_path / "wrong.trc")
    assert capture.markers is not None
    np.testing.assert_allclose(capture.markers.positions, cloud.positions, atol=1e-5)
    assert any(
        "With the unit stated in the file, m, the markers would span" in problem for problem in words(capture.problems)
    )


def test_of_two_people_one_is_named(tmp_path, cloud):
    both = replace(
        cloud, positions=np.concatenate([cloud.positions, cloud.positions + [2.0, 0.0, 0.0]], axis=1),
        labels=(*(f"Anna:{label}" for label in LABELS), *(f"Ben:{label}" for label in LABELS)),
    )  # fmt: skip
    path = write_c3d(tmp_path / "two.c3d", both)
    with pytest.raises(JobInvalid, match=r"2 subjects: Anna \(39 markers\), Ben \(39 markers\)") as refused:
        load_capture(path)
    assert "--subject-prefix" in (refused.value.hint or "")
    capture = load_capture(path, subject_prefix="Ben")
    assert capture.markers is not None
    np.testing.assert_allclose(capture.markers.positions, cloud.positions + [2.0, 0.0, 0.0], atol=1e-5)
    with pytest.raises(JobInvalid, match="no subject 'Cleo'"):
        load_capture(path, subject_prefix="Cleo")


@pytest.mark.parametrize(
    ("first", "second", "subject"),
    [
        ("Anna_{}", "Ben_{}", "Ben"), ("P1.{}", "P2.{}", "P2"), ("{}_1", "{}_2", "2"), ("{}:Anna", "{}:Ben", "Ben"),
        ("Anna:{}", "{}", "Unprefixed"), ("A B-{}", "Ben-{}", "Ben"),
    ],
)  # fmt: skip
def test_two_people_are_told_apart_whatever_their_labels_share(tmp_path, cloud, first, second, subject):
    labels = (*map(first.format, LABELS), *map(second.format, LABELS), "*4", "Stick")
    both = np.concatenate([cloud.positions, cloud.positions + [2.0, 0.0, 0.0], cloud.positions[:, :2]], axis=1)
    path = write_c3d(tmp_path / "two.c3d", replace(cloud, positions=both, labels=labels))
    with pytest.raises(JobInvalid, match=r"contains 2 subjects: .*\d\d markers.*\d\d markers"):
        load_capture(path)
    capture = load_capture(path, subject_prefix=subject)
    assert capture.markers is not None
    np.testing.assert_allclose(capture.markers.positions[:, :39], cloud.positions + [2.0, 0.0, 0.0], atol=1e-5)


@pytest.mark.parametrize("form", ["P01_{}", "{}-P01", "P01.{}"])
def test_two_people_may_wear_different_sets(form):
    """A whole body beside somebody's legs: most places of the second are the first one's too, not the reverse."""
    legs = [label for label in LABELS if label[1:] in ("ASI", "PSI", "THI", "KNE", "TIB", "ANK", "HEE", "TOE")]
    labels = [*map(form.format, LABELS), *(form.replace("1", "2").format(label) for label in legs)]
    assert {label.partition(":")[0] for label in by_subject(labels)} == {"P01", "P02"}
    parts = [f"Legs_{label}" if label in legs else f"Rest_{label}" for label in LABELS]
    assert list(by_subject(parts)) == parts


def test_sides_and_numbers_of_one_person_are_no_people(tmp_path, cloud):
    for labels in (LABELS, [f"Anna_{label}" for label in LABELS], [f"{label[:1]}_{label[1:]}" for label in LABELS]):
        capture = load_capture(write_c3d(tmp_path / "one.c3d", replace(cloud, labels=tuple(labels)), overwrite=True))
        assert capture.markers is not None and capture.markers.labels == tuple(labels)


def test_axes_of_segments_are_no_people():
    bones = ("PELVIS", "LFEMUR", "RFEMUR", "LTIBIA", "RTIBIA", "LFOOT", "RFOOT", "LTOES", "RTOES")
    labels = (*(f"{bone}_CGM_2.4{axis}" for bone in bones for axis in "OALP"), "LASI", "RASI", "LKNE")
    assert by_subject(labels) == labels


def test_the_only_subject_with_a_body_is_solved_and_said(tmp_path, cloud):
    labels = (*(f"Box:{label}" for label in ("a", "b", "c")), *(f"Anna:{label}" for label in LABELS[3:]))
    path = write_c3d(tmp_path / "box.c3d", replace(cloud, labels=labels))
    capture = load_capture(path)
    assert capture.markers is not None and capture.markers.labels == labels[3:]
    assert capture.others is not None and capture.others.labels == labels[:3]
    np.testing.assert_allclose(capture.others.positions, cloud.positions[:, :3], atol=1e-5)
    assert load_capture(path, subject_prefix="Anna").others.labels == labels[:3]
    assert any("Anna is solved. Subjects without body markers are ignored: Box (3" in n for n in words(capture.notes))


def test_rigid_bodies_named_by_bones_are_of_the_only_body(tmp_path, cloud):
    labels = (*("Box:a", "Box:b", "ForearmL:1", "ForearmL:2"), *(f"Anna:{label}" for label in LABELS[4:]))
    capture = load_capture(write_c3d(tmp_path / "bones.c3d", replace(cloud, labels=labels)))
    assert capture.markers is not None and capture.markers.labels == labels[2:]
    assert capture.others is not None and capture.others.labels == labels[:2]


def test_several_prefixes_are_one_person_where_they_are_named(tmp_path, cloud):
    parts = {label: part for part, count in (("Upper", 7), ("Lower", 39)) for label in LABELS[:count][::-1]}
    parts |= dict.fromkeys(LABELS[:7], "Upper")
    labels = tuple(f"{parts[label]}:{label}" for label in LABELS[:-2]) + ("Stick:1", "Stick:2")
    path = write_c3d(tmp_path / "parts.c3d", replace(cloud, labels=labels))
    capture = load_capture(path, subject_prefix="Upper, Lower")
    assert capture.markers is not None and capture.markers.labels == labels[:-2]
    with pytest.raises(JobInvalid, match="no subject 'Middle'"):
        load_capture(path, subject_prefix="Upper,Middle")


def test_parts_that_may_be_one_person_are_offered(tmp_path, cloud):
    labels = (
        *(f"ArmL:Marker{k}" for k in range(4)),
        *(f"Body:{label}" for label in LABELS[:5]),
        *["Stick:1", "Stick:2"],
    )
    few = replace(cloud, positions=cloud.positions[:, : len(labels)], labels=labels)
    with pytest.raises(JobInvalid, match="3 subjects") as refused:
        load_capture(write_c3d(tmp_path / "parts.c3d", few))
    assert "If they are parts of one person, name all of them with --subject-prefix ArmL,Body" in (
        refused.value.hint or ""
    )


def test_points_that_nobody_named_are_read_and_not_solved(tmp_path, cloud):
    path = write_c3d(tmp_path / "take.c3d", replace(cloud, labels=None))
    capture = load_capture(path)
    assert any("39 of 39 points have no label" in note for note in words(capture.notes))
    with pytest.raises(MarkersUnknown, match="The markers have no labels"):
        solve(capture)


def test_too_few_known_markers_say_how_many_are_needed(tmp_path, cloud):
    few = replace(cloud, positions=cloud.positions[:, :6], labels=("LASI", "RASI", "C7", "x1", "x2", "L_HJC"))
    capture = load_capture(write_c3d(tmp_path / "few.c3d", few))
    few_known = "Only 3 labels name positions on the body (LASI, RASI, C7), but a solve needs at least 8."
    assert any(problem.startswith(few_known) for problem in words(capture.problems))
    message = "needs 8 markers.*Of the 6 labels, 3 are known: LASI, RASI, C7. All labels: LASI, RASI, C7, x1, x2."
    with pytest.raises(MarkersUnknown, match=message):
        solve(capture)


def test_labels_that_name_no_places_are_left_to_the_network(tmp_path, cloud):
    numbered = replace(cloud, labels=tuple(f"traj_{number:03d}" for number in range(39)))
    capture = load_capture(write_c3d(tmp_path / "numbered.c3d", numbered))
    assert not capture.problems
    text = " ".join(words(capture.notes))
    assert "Only 0 of 39 labels name body parts, so the labelling network assigns the labels" in text
    assert "in a known layout" not in text


def test_one_frame_is_a_pose(tmp_path, cloud):
    capture = load_capture(write_c3d(tmp_path / "static.c3d", replace(cloud, positions=cloud.positions[:1])))
    assert any("a single frame" in problem for problem in words(capture.problems))
    with pytest.raises(TakeTooShort, match="needs 4 frames, but the take has 1"):
        solve(capture)
    motion = solve(capture, SolveSettings(method="frame")).motion
    assert motion.num_frames == 1 and np.nanmedian(motion.marker_residual_mm) < 15.0


def test_forces_only_and_a_rate_of_zero_are_named(tmp_path, cloud):
    empty = write_c3d(tmp_path / "empty.c3d", replace(cloud, positions=cloud.positions[:, :0], labels=()))
    with pytest.raises(NoDetections, match="The file contains no markers"):
        load_capture(empty)
    timed = write_c3d(tmp_path / "timed.c3d", cloud).read_bytes()
    still = tmp_path / "still.c3d"
    still.write_bytes(timed.replace(struct.pack("<f", 60.0), bytes(4)))
    with pytest.raises(FileDamaged, match="frame rate of 0"):
        load_capture(still)
    assert load_capture(still, fps=50.0).fps == 50.0


@pytest.mark.parametrize(
    ("template", "code", "text"),
    [("take7_{}", "label_affix_shared", "take7"), ("{}_filtered", "label_affix_shared", "filtered")],
)
def test_what_all_labels_share_and_what_may_mean_two_places_is_noted(tmp_path, cloud, template, code, text):
    named = with_points(replace(cloud, labels=tuple(template.format(label) for label in LABELS)), "LateralEpicondyleL")
    capture = load_capture(write_trc(tmp_path / "take.trc", named))
    found = {note.code: note for note in capture.notes}
    assert text in str(found[code].values["text"])
    assert [note.code for note in capture.notes].count("label_affix_shared") == 1
    assert found["labels_ambiguous"].where.markers == ("LateralEpicondyleL",)
    assert found["labels_ambiguous"].values["choices"] == ["LateralEpicondyleL (LELB or LKNE)"]
    sentences = " ".join(words(capture.notes))
    assert f"{text}' " in sentences and "nearly all labels" in sentences
    again = load_capture(write_capture(tmp_path / "take.npz", capture))
    assert again.notes == capture.notes, "figures and names come back from our own file"


def test_joints_that_skeletons_place_differently_are_left_out_by_name(tmp_path, cloud):
    of_suit = replace(cloud, positions=cloud.positions[:, : len(SUIT)], labels=SUIT)
    found = {note.code: note for note in load_capture(write_trc(tmp_path / "suit.trc", of_suit)).notes}
    assert found["labels_of_joint_centres"].values["count"] == 20
    assert found["points_left_out"].where.markers[:2] == ("SpineLow", "SpineMid")
    assert found["points_left_out"].values["reason"] == "joints"
