"""Takes named after another take of the person: pieces of tracks, mirror images, other poses, strangers' layouts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.errors import MarkersUnknown
from solver_backend.fitters.label_after import labelled_like, worn
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.io.markers.read import read_markers
from solver_backend.labelling.label_like import label_like, reference_of, triple_products
from solver_backend.types import Capture, MarkerCloud
from tests.support.takes_in_pieces import pieces, shares
from tests.support.words import codes, words
from tests.support.worn_markers import worn_markers

CLUSTERS = (
    "LFHD", "RFHD", "LBHD", "RBHD", "C7", "T10", "CLAV", "STRN", "LSHO", "LUPA", "LELB", "LFRM", "LWRA", "LWRB", "LFIN",
    "RSHO", "RUPA", "RELB", "RFRM", "RWRA", "RWRB", "RFIN", "LASI", "RASI", "LPSI", "RPSI", "LTHI", "LKNE", "LTIB",
    "LANK", "LHEE", "LTOE", "RTHI", "RKNE", "RTIB", "RANK", "RHEE", "RTOE",
)  # fmt: skip


def halves() -> tuple[MarkerCloud, MarkerCloud]:
    cloud = worn_markers(CLUSTERS, 240, fps=30.0).cloud
    return replace(cloud, positions=cloud.positions[:100]), replace(cloud, positions=cloud.positions[140:])


def test_the_other_half_of_a_take_gets_its_names() -> None:
    first, second = halves()
    bare, truth = pieces(second, 1)
    right, wrong = shares(label_like(bare, reference_of(first)).point_labels, truth)
    assert right >= 99.0 and wrong <= 0.5


def test_a_mirror_image_has_the_other_triple_product() -> None:
    points = np.random.default_rng(0).normal(size=(5, 4, 3))
    mirrored = points * [1.0, -1.0, 1.0]
    here, there = (triple_products(p[:, 0], p[:, 1:]) for p in (points, mirrored))
    np.testing.assert_allclose(here, -there)
    assert (np.abs(here) <= 1.0).all()


@pytest.mark.parametrize(
    ("like", "take"),
    [
        ("nimble/Sprinter/run0350cms.trc", "nimble/Sprinter/run0700cms.trc"),
        ("nimble/Subject4/MarkerData/squats1.trc", "nimble/Subject4/MarkerData/walking1.trc"),
        ("opensim/walking2.c3d", "opensim/walking5.c3d"),
    ],
)
def test_recordings_of_other_layouts(shared_data: Path, like: str, take: str) -> None:
    one, two = (read_markers(shared_data / "markers" / name).cloud for name in (like, take))
    one = worn(one)
    labels = tuple(label for label in one.labels or () if label in (two.labels or ()))
    one, two = (cloud.columns([(cloud.labels or ()).index(label) for label in labels], labels) for cloud in (one, two))
    step = max(1, int(two.fps // 60))
    two = replace(two, positions=two.positions[::step][:300], fps=two.fps / step, residual=None)
    bare, truth = pieces(two, 2)
    right, wrong = shares(label_like(bare, reference_of(one)).point_labels, truth)
    assert right >= 99.0 and wrong <= 0.5


@pytest.mark.slow
def test_a_layout_of_strange_names_is_read_by_the_network_as_well(shared_data: Path) -> None:
    """By distances alone a third of the points get their name, and half another one."""
    clouds = []
    for name in ("m10_s02_e02", "m01_s02_e02"):
        with np.load(shared_data / "markers" / "ui_prmd" / f"{name}.npz", allow_pickle=False) as data:
            points = 1e-4 * data["positions_01mm"][:600:6].astype(float)
        points[(points == 0).all(-1)] = np.nan
        clouds.append(MarkerCloud(points, 100.0 / 6, tuple(f"X{k}q" for k in range(points.shape[1]))))
    bare, truth = pieces(clouds[1], 2)
    _, named = labelled_like(Capture("take", markers=bare), Capture("like", markers=clouds[0]))
    right, wrong = shares(named.point_labels, truth)
    assert right >= 99.0 and wrong <= 0.5


def test_the_verb_writes_the_names(tmp_path: Path) -> None:
    first, second = halves()
    like = write_c3d(tmp_path / "like.c3d", first)
    bare, _ = pieces(second, 3, 0.0)
    write_c3d(tmp_path / "bare.c3d", replace(bare, labels=tuple(f"*{i}" for i in range(bare.positions.shape[1]))))
    assert (
        main(["markers label", str(tmp_path / "bare.c3d"), "--like", str(like), "--out", str(tmp_path / "out.c3d")])
        == 0
    )
    found = read_markers(tmp_path / "out.c3d").cloud
    assert found.labels is not None and set(CLUSTERS) <= set(found.labels)
    columns = [found.labels.index(label) for label in CLUSTERS]
    np.testing.assert_allclose(found.positions[:, columns], second.positions, atol=1e-4)


def test_a_take_without_names_names_nobody() -> None:
    first, second = halves()
    nameless = Capture("like", markers=replace(first, labels=None))
    with pytest.raises(MarkersUnknown, match="has 0 labelled markers"):
        labelled_like(Capture("take", markers=second), nameless)


@pytest.mark.slow
def test_what_stays_without_a_name_is_noted_in_percent() -> None:
    first, second = halves()
    bare, _ = pieces(second, 3, 0.0)
    rng = np.random.default_rng(5)
    strays = rng.uniform([-3.0, -3.0, 0.0], [3.0, 3.0, 2.5], (len(bare.positions), 6, 3))
    with_strays = MarkerCloud(np.concatenate([bare.positions, strays], axis=1), bare.fps)
    clean, _ = labelled_like(Capture("take", markers=bare), Capture("like", markers=first))
    assert codes(clean.notes) == ("points_named",) and not clean.problems
    assert (clean.notes[0].values["take"], clean.notes[0].values["count"]) == ("like", len(CLUSTERS))
    noisy, take = labelled_like(Capture("take", markers=with_strays), Capture("like", markers=first))
    there = np.isfinite(with_strays.positions).all(-1)
    percent = 100.0 * float((take.point_labels[there] < 0).mean())
    [doubt] = noisy.problems
    assert doubt.code == "points_not_named" and doubt.values["percent"] == pytest.approx(percent, rel=1e-5)
    assert f": {percent:.0f} % remain without a label." in words([doubt])[0] and percent > 10.0
