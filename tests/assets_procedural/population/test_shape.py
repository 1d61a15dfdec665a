"""Population statistics, displacement fields, measures and the regressor."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from assets_procedural.detail.fingers import STRAIGHTENED
from assets_procedural.population.shape import RestFrame, build_fields, displace, population_mean
from assets_procedural.population.statistics import (
    MEASURES,
    NUM_LENGTHS,
    OFFSETS,
    Measures,
    load_statistics,
    place_measures,
    summarise,
)
from assets_procedural.quality.contact_sheet import BakedBody, read_baked
from assets_procedural.skeleton.skinning import fit_regressor
from solver_backend.exchange.errors import FileDamaged


@pytest.fixture(scope="module")
def body() -> BakedBody:
    return read_baked()


@pytest.fixture(scope="module")
def on_floor(body: BakedBody) -> tuple[np.ndarray, np.ndarray, Measures]:
    floor = np.array([0.0, body.vertices[:, 1].min(), 0.0])
    vertices, joints = body.vertices - floor, body.joints - floor
    return vertices, joints, place_measures(vertices, body.faces, joints, STRAIGHTENED)


def test_table_is_a_valid_covariance() -> None:
    statistics = load_statistics()
    np.testing.assert_allclose(np.diag(statistics.correlation), 1.0)
    assert np.linalg.eigvalsh(statistics.covariance).min() > 0
    assert np.all(statistics.p01 < statistics.mean) and np.all(statistics.mean < statistics.p99)


def test_men_and_women_weigh_half_each() -> None:
    values = np.array([[1.0], [1.0], [1.0], [3.0]])
    found = summarise(values, np.array([True, True, True, False]))
    assert found.mean[0] == pytest.approx(2.0) and found.sd[0] == pytest.approx(1.0)


def test_other_measures_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    path.write_text(json.dumps({"measures": ["stature"]}))
    with pytest.raises(FileDamaged, match=r"lists \['stature'\]"):
        load_statistics(path)


@pytest.mark.shared
def test_table_equals_the_survey(shared_data: Path) -> None:
    survey = shared_data / "anthropometry" / "ANSUR_II_BOTH_Public.csv"
    if not survey.is_file():
        pytest.skip("no ANSUR II file among the recordings")
    rows = [line.split(",") for line in survey.read_text(encoding="latin-1").splitlines()]
    column = rows[0].index("waistcircumference")
    sex = rows[0].index("Gender")
    groups = [np.mean([float(row[column]) for row in rows[1:] if row[sex] == name]) for name in ("Male", "Female")]
    expected = 0.5 * sum(groups) / 1000
    assert load_statistics().mean[MEASURES.index("waistcircumference")] == pytest.approx(expected, abs=1e-4)


def test_neutral_body_measures_the_population_mean(on_floor: tuple[np.ndarray, np.ndarray, Measures]) -> None:
    vertices, joints, measures = on_floor
    np.testing.assert_allclose(measures(vertices, joints), population_mean(load_statistics()), atol=1e-4)


def test_fields_are_odd_in_x_and_smooth(on_floor: tuple[np.ndarray, np.ndarray, Measures]) -> None:
    vertices, joints, _ = on_floor
    fields = build_fields(RestFrame(joints, float(vertices[:, 1].max())))
    assert set(fields) == set(MEASURES)
    moved, mirrored = displace(fields, vertices), displace(fields, vertices * [-1.0, 1.0, 1.0])
    np.testing.assert_array_equal(mirrored, moved * [-1.0, 1.0, 1.0])
    nudged = displace(fields, vertices + [0.0, 1e-6, 0.0])
    assert np.abs(nudged - moved).max() < 1e-4


def test_lengths_are_joint_distances(on_floor: tuple[np.ndarray, np.ndarray, Measures]) -> None:
    vertices, joints, measures = on_floor
    stretched = measures(2.0 * vertices, 2.0 * joints) - measures(vertices, joints)
    plain = np.array([OFFSETS.get(name, 0.0) for name in MEASURES])
    np.testing.assert_allclose(stretched, measures(vertices, joints) - plain, atol=1e-9)
    assert NUM_LENGTHS == 9


def test_tape_around_a_cylinder_is_its_girth() -> None:
    from assets_procedural.population.statistics import place_tape

    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ring = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], 1)
    vertices = np.concatenate([ring - [0, 1, 0], ring + [0, 1, 0]])
    k = np.arange(200)
    n = (k + 1) % 200
    faces = np.concatenate([np.stack([k, k + 200, n], 1), np.stack([n, k + 200, n + 200], 1)])
    tape = place_tape(vertices, faces, (0, 1, 0), (0, 0.3, 0), box=5.0)
    assert tape.length(vertices) == pytest.approx(2 * np.pi, rel=1e-3)


def test_regressor_reproduces_joints_and_their_directions() -> None:
    rng = np.random.default_rng(4)
    left = rng.uniform([0.0, -1.0, -1.0], 1.0, (300, 3))
    vertices = np.concatenate([left, left * [-1, 1, 1]])
    mirror = np.concatenate([np.arange(300, 600), np.arange(300)])
    matrix = rng.normal(size=(3, 3, 10)) * 0.1
    matrix[0, 1:], matrix[1:, 0] = 0.0, 0.0  # symmetric shapes
    joints = np.zeros((24, 3))
    vertex_dirs = np.einsum("abk,vb->vak", matrix, vertices)
    regressor = fit_regressor(vertices, vertex_dirs, joints, np.zeros((24, 3, 10)), mirror)
    np.testing.assert_allclose(regressor.sum(axis=1), 1.0)
    assert np.abs(regressor @ vertices).max() < 2e-5 and regressor.min() >= 0.0
