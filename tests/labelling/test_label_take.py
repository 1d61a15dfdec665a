"""Takes without names: real ones, spoiled ones, half-labelled ones; and names from a person."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.marker_names import name_markers
from solver_backend.cli.main import main
from solver_backend.exchange.errors import CaptureInvalid, FileDamaged, MarkersUnknown, NoDetections
from solver_backend.fitters.label_first import labelled_capture, named_points, needs_labels
from solver_backend.fitters.measurements.markers import known_markers_of, no_person_in
from solver_backend.fitters.recipes.live import fit_average_person
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unit
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.io.markers.read import read_markers
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.io.native.user_labels_file import read_user_labels
from solver_backend.labelling.label_take import LabelledTake, Votes, _frames_to_read, label_take
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.labelling.point_network import MOST_POINTS, load_network
from solver_backend.labelling.tracklets import tracklets_of
from solver_backend.synthesis.embedded.demo import record_markers
from solver_backend.types import Capture, MarkerCloud
from tests.support.unlabelled_takes import score, stripped
from tests.support.words import words


@pytest.fixture(scope="module")
def demo() -> MarkerCloud:
    return record_markers(90, seed=5).cloud


@pytest.fixture(scope="module")
def labelled(demo: MarkerCloud) -> LabelledTake:
    """Return the demo's markers without names, named by the network."""
    return label_take(MarkerCloud(demo.positions, demo.fps), load_network(), fit_average_person)


def test_a_real_walk_gets_its_labels_back(shared_data):
    cloud = read_markers(shared_data / "markers" / "cmu_pairs" / "02_01.c3d").cloud
    bare = stripped(cloud, 3)
    found = score(label_take(bare.cloud, load_network(), fit_average_person), bare.truth)
    assert found.right >= 98.5 and found.wrong <= 0.5


def test_a_take_that_the_network_does_not_know_is_refused_with_its_share(shared_data):
    """57 markers in clusters, prone: a quarter of the points got names, heels 20 cm from the heels."""
    cloud = read_markers(shared_data / "markers" / "automarkerlabel" / "S01_Pronetokneel01_mksrem.c3d").cloud
    capture = Capture("prone", markers=MarkerCloud(cloud.positions[:240:8], cloud.fps / 8, None))
    with pytest.raises(MarkersUnknown, match=r"recognises only [1-4]\d % of them"):
        labelled_capture(capture)
    assert labelled_capture(capture, always=True)[1] is not None


@pytest.mark.parametrize("seed", range(8))
def test_random_points_are_no_person(seed):
    """Of still random points, the network names up to 60 %, and a body fits any cloud that does not move."""
    rng = np.random.default_rng(seed)
    count, box = int(rng.integers(45, 75)), ([0.6, 0.6, 1.8], [0.4, 1.5, 1.8])[seed % 2]
    points = rng.uniform(size=(1, count, 3)) * box + 0.001 * rng.normal(size=(40, count, 3))
    with pytest.raises(MarkersUnknown, match="finds no person|recognises only"):
        labelled_capture(Capture("random", markers=MarkerCloud(points, 30.0)))


@pytest.mark.slow
def test_a_spoiled_walk_keeps_most_and_is_seldom_wrong(shared_data):
    cloud = read_markers(shared_data / "markers" / "cmu_pairs" / "02_01.c3d").cloud
    bare = stripped(cloud, 4, missing=5, ghosts=3)
    found = score(label_take(bare.cloud, load_network(), fit_average_person), bare.truth)
    assert found.right >= 92.0 and found.wrong <= 3.0


@pytest.mark.slow
def test_the_order_of_columns_does_not_matter(demo, labelled):
    order = np.random.default_rng(0).permutation(demo.positions.shape[1])
    there = label_take(MarkerCloud(demo.positions[:, order], demo.fps), load_network(), fit_average_person)
    same = labelled.labels[:, order] == there.labels
    assert same.mean() > 0.99


def test_no_marker_is_at_two_places_of_a_frame(labelled):
    for frame in labelled.labels[::30]:
        markers = frame[(frame >= 0) & (frame < GHOST)]
        assert len(set(markers.tolist())) == len(markers)


def test_what_a_person_tells_binds_the_whole_stretch(demo, labelled):
    bare = MarkerCloud(demo.positions, demo.fps)
    network = load_network()
    column = int(np.flatnonzero((labelled.labels[0] >= 0) & (labelled.labels[0] < GHOST))[0])
    other = next(name for i, name in enumerate(MARKERS) if not (labelled.labels == i).any())
    after = label_take(bare, network, fit_average_person, user_labels={(column, 0): other})
    mine = after.tracklets.number[:, column] == after.tracklets.number[0, column]
    assert (after.labels[mine, column] == MARKERS.index(other)).all()
    assert (after.confidence[mine, column] == 1.0).all()
    assert (label_take(bare, network, fit_average_person, user_labels={(column, 0): ""}).labels[0, column]) == GHOST


def test_too_few_points_are_named():
    with pytest.raises(NoDetections, match="No frame has 6 points"):
        label_take(MarkerCloud(np.zeros((5, 3, 3)), 100.0), load_network(), fit_average_person)


def test_labelled_takes_are_left_alone_and_half_labelled_ones_keep_their_names(demo):
    assert not needs_labels(demo)
    capture = Capture("take", markers=demo)
    assert labelled_capture(capture)[0] is capture
    nameless = tuple(f"*{i}" if i % 3 else label for i, label in enumerate(demo.labels or ()))
    half = MarkerCloud(demo.positions, demo.fps, nameless)
    assert needs_labels(half)
    told = named_points(half)
    labelled, take = labelled_capture(Capture("take", markers=half))
    assert take is not None and labelled.markers is not None and "labelled as" in words(labelled.notes)[-1]
    for (column, frame), name in told.items():
        assert take.labels[frame, column] == MARKERS.index(name)


@pytest.mark.slow
def test_labels_that_say_nothing_are_persistent_tracks(demo):
    positions = demo.positions.copy()
    positions[30:60, :4] = np.nan  # gaps that would begin new tracks
    numbered = MarkerCloud(positions, demo.fps, tuple(f"Point {k}" for k in range(positions.shape[1])))
    capture, take = labelled_capture(Capture("take", markers=numbered))
    assert take is not None and capture.markers is not None
    assert "labelled as" in words(capture.notes)[-1]
    known = name_markers(demo.labels or ()).known
    truth = [MARKERS.index(known[label]) if known.get(label) in MARKERS else GHOST for label in demo.labels or ()]
    there = np.isfinite(positions).all(-1)
    columns = [set(take.labels[there[:, column], column].tolist()) for column in range(len(truth))]
    assert all(len(labels) <= 1 for labels in columns)
    assert np.mean([truth[i] in labels for i, labels in enumerate(columns)]) > 0.95


def test_points_without_a_place_keep_the_names_that_somebody_gave_them():
    points = np.arange(18.0).reshape(2, 3, 3)
    source = MarkerCloud(points, 30.0, ("P7", "P8", "*3"))
    labels = np.array([[MARKERS.index("C7"), GHOST, -1]] * 2)
    nothing = np.zeros((3, 54))
    votes = Votes(np.arange(2), np.zeros((2, 77, 3)), np.zeros((2, 77, 3, 3)), nothing, nothing, np.zeros(3))
    take = LabelledTake(labels, np.ones((2, 3)), tracklets_of(points, 30.0), labels[0], np.ones(3), votes)
    assert take.cloud(source).labels == ("C7", "P8", "*2")
    assert take.cloud(MarkerCloud(points, 30.0)).labels == ("C7", "*1", "*2")


def unread(*_: object) -> None:
    raise AssertionError("the network read it")


def test_a_crowd_is_not_read_in_vain():
    """Of more points than a person's the network names too small a share, whatever they are."""
    points = np.random.default_rng(0).uniform(-3, 3, (4, 120, 3))
    with pytest.raises(MarkersUnknown, match=r"120 of them are visible at once.*one person with up to 53 markers"):
        labelled_capture(Capture("crowd", markers=MarkerCloud(points, 30.0)), network=unread)
    own = MarkerCloud(points, 30.0, tuple(f"M{k}" for k in range(120)))
    capture, take = labelled_capture(Capture("crowd", markers=own), network=unread)
    assert take is None and capture.markers is own
    assert "120 markers are visible at once" in words(capture.problems)[-1]


@pytest.mark.parametrize(("size_m", "reason"), [(0.2, "within 0"), (1.4, "one rigid body")])
def test_a_face_or_a_rigid_body_is_no_person(size_m, reason):
    """Of seven markers on a prop, the network names a third as markers of a body."""
    rng, t = np.random.default_rng(2), np.linspace(0.0, 3.0, 120)
    own = size_m / 2.0 * unit(rng.normal(size=(7, 3)))
    turns = exp_so3(t[:, None] * [0.3, 0.2, 1.0])
    points = own @ turns.swapaxes(-1, -2) + np.stack([t, np.sin(t), 1.0 + 0.0 * t], axis=1)[:, None]
    points = points[:, rng.permutation(7)] + 0.0005 * rng.normal(size=points.shape)
    for labels in (None, tuple(f"lip_{i}" for i in range(7))):
        capture = Capture("prop", markers=MarkerCloud(points, 40.0, labels))
        with pytest.raises(MarkersUnknown, match=reason):
            labelled_capture(capture, network=unread, always=True)
    with pytest.raises(MarkersUnknown, match=f"{reason}.*no body"):
        known_markers_of(MarkerCloud(points, 40.0, labels))


def test_a_person_who_stands_still_or_shows_an_arm_is_not_called_a_prop(demo):
    still = np.repeat(demo.positions[:1], 50, axis=0)
    assert not no_person_in(still) and not no_person_in(demo.positions)
    assert not no_person_in(np.full((5, 7, 3), np.nan))
    carried = still[:, :15] + np.linspace(0.0, 2.0, 50)[:, None, None]
    turned = demo.positions[0, :15] @ exp_so3(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])).swapaxes(-1, -2)
    assert not no_person_in(carried) and not no_person_in(turned)  # in a chair, and in two frames alone


def test_a_person_who_enters_late_is_seen_and_a_wrong_unit_is_named(demo):
    stray = np.random.default_rng(0).normal(size=(1, 3, 3)).repeat(200, axis=0) * 0.05
    person = np.full((200, demo.positions.shape[1], 3), np.nan)
    person[150:] = demo.positions[:50]
    assert "within 0" in no_person_in(stray)
    assert not no_person_in(np.concatenate([person, stray], axis=1))
    assert "unit is wrong" in no_person_in(0.001 * demo.positions)


def test_a_person_who_is_labelled_in_a_crowd_is_solved_by_these_labels(demo):
    crowd = np.random.default_rng(0).uniform(-3, 3, (len(demo.positions), 100, 3))
    labels = (*demo.labels, *(f"*{k}" for k in range(100)))
    half = MarkerCloud(np.concatenate([demo.positions, crowd], axis=1), demo.fps, labels)
    capture, take = labelled_capture(Capture("crowd", markers=half), network=unread)
    assert needs_labels(half) and take is None and capture.markers is half
    assert "are not used in the solve" in words(capture.problems)[-1]


def test_a_crowd_is_read_in_few_frames():
    points = np.tile(np.random.default_rng(0).uniform(-3, 3, (1, 1000, 3)), (120, 1, 1))
    points[:10, :2] = points[13:, 0] = points[21:, 1] = np.nan
    read = _frames_to_read(np.isfinite(points).all(-1), tracklets_of(points, 60.0), 60.0)
    assert read.tolist() == [0, 12, 50, 100]  # 12 is inside both short stretches


def test_labels_of_part_of_a_body_are_not_made_up(demo):
    known = name_markers(demo.labels or ()).known
    lower = ("THI", "KNE", "SHN", "ANK", "HEE", "TOE")
    legs = [i for i, label in enumerate(demo.labels or ()) if known.get(label, "")[1:] in lower]
    numbered = MarkerCloud(demo.positions[:, legs], demo.fps, tuple(f"M{k}" for k in range(len(legs))))
    capture, take = labelled_capture(Capture("take", markers=numbered))
    assert take is None and capture.markers is numbered
    assert "The labelling network is not used" in words(capture.problems)[-1]


def test_the_verb_writes_labels_and_a_page(tmp_path: Path, demo, capsys):
    source, out, page = tmp_path / "bare.c3d", tmp_path / "out" / "labelled.c3d", tmp_path / "page.html"
    write_c3d(source, MarkerCloud(demo.positions, demo.fps))
    labels = tmp_path / "labels.json"
    labels.write_text(json.dumps({
        "format": "manifold_mocap_user_labels", "version": 1, "points": [{"point": 0, "frame": 0, "marker": "ARIEL"}],
    }))  # fmt: skip
    command = [
        "markers label",
        str(source),
        "--out",
        str(out),
        "--report",
        str(page),
        "--labels",
        str(labels),
        "--json",
    ]
    assert main(command) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["named_percent"] + result["none_percent"] + result["unknown_percent"] == pytest.approx(100, abs=0.05)
    assert next(s for s in result["stretches"] if s["point"] == 0)["label"] == "ARIEL"
    cloud = read_markers(out).cloud
    assert cloud.labels is not None and "ARIEL" in cloud.labels
    text = page.read_text(encoding="utf-8")
    assert "Frame ranges to check" in text and "http://" not in text
    assert main(command) == 3


def test_labels_in_a_capture_keep_covariances(tmp_path: Path, demo):
    source, out = tmp_path / "cloud.npz", tmp_path / "labelled.npz"
    positions = demo.positions[:40]
    covariance = np.where(np.isfinite(positions).all(-1)[..., None, None], 1e-6 * np.eye(3), np.nan)
    write_capture(source, Capture("cloud", markers=MarkerCloud(positions, demo.fps, None, None, covariance)))
    assert main(["markers label", str(source), "--out", str(out)]) == 0
    markers = read_capture(out).markers
    assert markers is not None and markers.labels is not None and "C7" in markers.labels
    assert markers.covariance is not None
    seen = np.isfinite(markers.positions).all(-1)
    np.testing.assert_allclose(
        markers.covariance[seen], np.broadcast_to(1e-6 * np.eye(3), (seen.sum(), 3, 3)), rtol=1e-6
    )


@pytest.mark.parametrize(
    ("item", "error"),
    [
        ({"point": 0, "frame": 0, "marker": "NOSE"}, MarkersUnknown),
        ({"point": 999, "frame": 0, "marker": "C7"}, FileDamaged),
        ({"point": 0, "frame": -1, "marker": "C7"}, FileDamaged),
        ({"point": "0", "frame": 0, "marker": "C7"}, FileDamaged),
        ("C7", FileDamaged),
    ],
)
def test_a_file_of_labels_that_makes_no_sense_is_refused(tmp_path, demo, item, error):
    path = tmp_path / "labels.json"
    path.write_text(json.dumps({"format": "manifold_mocap_user_labels", "version": 1, "points": [item]}))
    with pytest.raises(error):
        read_user_labels(path, demo)


def test_a_points_residual_goes_with_its_label(demo):
    rng = np.random.default_rng(0)
    order = rng.permutation(demo.positions.shape[1])
    residual = np.where(np.isfinite(demo.positions).all(-1), rng.uniform(1e-4, 3e-3, demo.positions.shape[:2]), np.nan)
    covariance = residual[..., None, None] * np.arange(9.0).reshape(3, 3)
    bare = MarkerCloud(demo.positions[:, order], demo.fps, None, residual[:, order], covariance[:, order])
    named = label_take(bare, load_network(), fit_average_person).cloud(bare)
    for column, label in enumerate(named.labels):
        if label in demo.labels:
            true = demo.labels.index(label)
            same = (named.positions[:, column] == demo.positions[:, true]).all(-1)
            assert same.any() and (named.residual[same, column] == residual[same, true]).all()
            assert (named.covariance[same, column] == covariance[same, true]).all()
    assert (np.isnan(named.residual) == np.isnan(named.positions[..., 0])).all()


def test_more_points_than_can_be_compared_are_named(demo):
    rng, network = np.random.default_rng(0), load_network()
    crowd = MarkerCloud(rng.uniform(0.0, 2.0, (3, MOST_POINTS + 1, 3)), 100.0)
    with pytest.raises(CaptureInvalid, match=f"{MOST_POINTS + 1} points in frame 0"):
        label_take(crowd, network, fit_average_person)
    blinking = np.full((120, 100, 3), np.nan)
    blinking[::2] = rng.uniform(0.0, 2.0, (60, 100, 3))
    with pytest.raises(CaptureInvalid, match="track segments"):
        label_take(MarkerCloud(blinking, 10.0), network, fit_average_person)


@pytest.mark.slow
def test_frames_read_in_smaller_parts_say_the_same(demo, labelled, monkeypatch):
    bare = MarkerCloud(demo.positions, demo.fps)
    monkeypatch.setattr("solver_backend.labelling.point_network._PAIRS", 3 * demo.positions.shape[1] ** 2)
    parts = label_take(bare, load_network(), fit_average_person)
    assert np.array_equal(labelled.labels, parts.labels)
    assert np.allclose(labelled.votes.landmarks, parts.votes.landmarks, atol=1e-4)
