"""Takes of one person under the same names: exchanges that the other takes contradict, and points that have a place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.markers import marker_layout
from solver_backend.cli.describe_markers import describe_person
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.labelling.label_like import TakeShape, _odd_takes, exchange_gains, names_over_takes, shape_of
from solver_backend.types import Capture, MarkerCloud
from tests.support.worn_markers import worn_markers

LABELS = (*marker_layout("CMU_41"), "LFSH", "LBSH", "T4")


@pytest.fixture(scope="module")
def takes() -> tuple[MarkerCloud, ...]:
    """Return three takes of one person: parts of a walk."""
    cloud = worn_markers(LABELS, 180, fps=30.0, step=2).cloud
    return tuple(replace(cloud, positions=part) for part in np.split(cloud.positions, 3))


def swapped(cloud: MarkerCloud, *pairs: tuple[str, str]) -> MarkerCloud:
    names = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
    return replace(cloud, labels=tuple(names.get(label, label) for label in cloud.labels or ()))


@pytest.mark.parametrize(
    ("pair", "take"),
    [(("C7", "T4"), 0), (("LFSH", "LBSH"), 1), (("LUPA", "LFRM"), 2), (("LWRA", "LWRB"), 1), (("LFHD", "LBHD"), 2)],
)
def test_an_exchange_that_the_other_takes_contradict_is_mended(takes, pair, take):
    given = [swapped(cloud, pair) if t == take else cloud for t, cloud in enumerate(takes)]
    found = names_over_takes(given)
    assert [(change.take, {change.first, change.second}, change.mended) for change in found.changes] == [
        (take, set(pair), True)
    ]
    assert [cloud.labels for cloud in found.clouds] == [LABELS] * 3


def test_takes_that_agree_are_left_alone(takes):
    found = names_over_takes(takes)
    assert found.changes == () and found.clouds == tuple(takes)
    assert names_over_takes(takes[:1]).clouds == tuple(takes[:1])


def test_many_takes_are_compared_with_some(takes, monkeypatch):
    monkeypatch.setattr("solver_backend.labelling.label_like.MOST_TOGETHER", 4)
    given = [*takes, swapped(takes[1], ("C7", "T4")), swapped(takes[2], ("LUPA", "LFRM")), takes[0]]
    found = names_over_takes(given)
    changed = {(change.take, frozenset((change.first, change.second))) for change in found.changes}
    assert changed == {(3, frozenset(("C7", "T4"))), (4, frozenset(("LUPA", "LFRM")))}
    assert all(cloud.labels == LABELS for cloud in found.clouds)


def test_takes_without_anything_in_common_or_of_a_few_frames_are_left(takes):
    strangers = [replace(takes[0], labels=tuple(f"{k}_{label}" for label in LABELS)) for k in range(3)]
    assert names_over_takes(strangers).changes == ()
    short = [replace(cloud, positions=cloud.positions[:3]) for cloud in takes]
    assert names_over_takes([short[0], swapped(short[1], ("C7", "T4")), short[2]]).changes == ()


def test_names_that_the_user_assigned_are_kept(takes):
    given = [takes[0], takes[1], swapped(takes[2], ("C7", "T4"))]
    assert names_over_takes(given, kept={"C7"}).clouds == tuple(given)


@pytest.mark.parametrize("take", [0, 1])
def test_of_two_takes_the_layout_knows_which_is_right(takes, take):
    given = [swapped(cloud, ("C7", "T4")) if t == take else cloud for t, cloud in enumerate(takes[:2])]
    found = names_over_takes(given)
    assert [(change.take, change.mended) for change in found.changes] == [(take, True)]


def test_of_two_takes_that_no_layout_knows_both_are_left_and_reported(takes):
    strange = {label: f"X{k}" for k, label in enumerate(LABELS)}
    given = [replace(cloud, labels=tuple(strange.values())) for cloud in takes[:2]]
    pair = (strange["C7"], strange["T4"])
    found = names_over_takes([given[0], swapped(given[1], pair)])
    assert [change.mended for change in found.changes] == [False] and found.clouds[0].labels == given[0].labels
    third = replace(takes[2], labels=tuple(strange.values()))
    mended = names_over_takes([given[0], swapped(given[1], pair), third])
    assert [(change.take, change.mended) for change in mended.changes] == [(1, True)]


def test_a_point_without_a_name_gets_the_one_that_stands_elsewhere(takes):
    """C7's label is T4's marker in one take, whose C7 is a point without a name."""
    names = {"T4": "C7", "C7": "*12"}
    others = [replace(cloud, labels=tuple("*7" if label == "T4" else label for label in LABELS)) for cloud in takes]
    given = [*others[:2], replace(takes[2], labels=tuple(names.get(label, label) for label in LABELS))]
    found = names_over_takes(given)
    assert [(c.take, {c.first, c.second}, c.mended) for c in found.changes] == [(2, {"C7", "*12"}, True)]
    column = (found.clouds[2].labels or ()).index("C7")
    np.testing.assert_array_equal(found.clouds[2].positions[:, column], takes[2].positions[:, LABELS.index("C7")])


def test_an_exchange_gains_where_one_take_has_the_names_the_other_way_round(takes):
    one, other = (shape_of(cloud.positions) for cloud in takes[:2])
    pair = np.array([[LABELS.index("LFSH"), LABELS.index("LBSH")]])
    order = np.arange(len(LABELS))
    order[pair[0]] = pair[0, ::-1]
    pairs = np.ix_(order, order)
    turned = TakeShape(other.points[:, order], other.distance[pairs], other.variance[pairs])
    straight, crossed = (float(exchange_gains(one, take, pair)[0]) for take in (other, turned))
    assert straight < -3.0 and crossed > 3.0


@pytest.mark.parametrize(
    ("gain", "layout", "certain"),
    [
        (7.0, (5.0, -2.0), True), (7.0, (2.0, -2.0), False), (4.0, (5.0, -2.0), False), (2.0, (5.0, -2.0), None),
        (3.5, (0.0, 0.0, 0.0), True), (2.0, (0.0, 0.0, 0.0), False), (1.0, (0.0, 0.0, 0.0), None),
        (3.5, (0.0,) * 4, True), (2.0, (0.0,) * 4, False),
    ],
)  # fmt: skip
def test_a_swap_leads_by_the_bound_of_all_evidence(gain: float, layout: tuple[float, ...], certain: bool | None):
    """At most two other takes count. Between two takes, the layout also leads by the bound."""
    gains = np.full((len(layout), len(layout)), -20.0)
    gains[0] = gains[:, 0] = 4.0
    gains[0, -1] = gains[-1, 0] = gain
    np.fill_diagonal(gains, np.nan)
    found = [(take, sure) for take, _, sure in _odd_takes(gains, np.array(layout))]
    assert found == ([] if certain is None else [(0, certain)])


def test_a_calibration_says_which_names_it_exchanged(takes):
    given = [takes[0], takes[1], swapped(takes[2], ("LUPA", "LFRM"))]
    captures = [Capture(f"take {k}", markers=cloud) for k, cloud in enumerate(given)]
    person = calibrate_person(captures, SolveSettings(iterations=1))
    text, data = describe_person(person)
    assert "LFRM and LUPA in take 3" in text and len(person.labels) == len(LABELS)
    assert [item["code"] for item in data["diagnostics"]] == ["names_exchanged_in_takes"]


def test_real_takes_of_one_person(shared_data: Path):
    """The forearm's and the upper arm's marker of one of them hold each other's labels in the file."""
    clouds = []
    for name in ("m01_s08_e02", "m05_s08_e02", "m02_s08_e02_inc", "m08_s08_e02"):
        with np.load(shared_data / "markers" / "ui_prmd" / f"{name}.npz", allow_pickle=False) as data:
            points, labels = 1e-4 * data["positions_01mm"][::4].astype(float), tuple(map(str, data["labels"]))
        points[(points == 0).all(-1)] = np.nan
        clouds.append(MarkerCloud(points, 25.0, labels))
    found = names_over_takes(clouds)
    assert [(c.take, c.first, c.second) for c in found.changes if c.mended] == [(2, "LFRM", "LUPA")]
