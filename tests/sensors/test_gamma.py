"""Up, floor and origin by three markers on the floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.camera_calibration.formats import write_calibration
from solver_backend.cameras.projection import project
from solver_backend.cli.main import main
from solver_backend.exchange.errors import CalibrationMismatch
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.calibration.read import read_calibration
from solver_backend.sensors.wand.gamma import Gamma, GammaInvalid, GammaNotFound, gamma_clouds, ground_from_gamma
from tests.support.waved_wand import SIZE, Waving, as_tables, sensors, waved

MARKERS = np.array([[0.1, 0.2, 0.007], [0.1, -0.4, 0.007], [0.5, 0.2, 0.007]])
"""Corner, the long edge's end, the short edge's end."""


def clouds(rng: np.random.Generator, count: int = 150, sigma_m: float = 0.004, ghosts: int = 4) -> list[np.ndarray]:
    found = []
    for _ in range(count):
        others = rng.uniform([-2, -2, 0], [2, 2, 2], (int(rng.integers(0, ghosts)), 3))
        found.append(rng.permutation(np.concatenate([MARKERS + rng.normal(0, sigma_m, (3, 3)), others])))
    return found


@pytest.mark.parametrize("seed", range(8))
def test_up_is_within_a_fifth_of_a_degree_and_as_sure_as_it_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, t = exp_so3(rng.normal(0, 1.0, 3)), rng.normal(0, 1.0, 3)
    places = sensors(3).centres
    found = ground_from_gamma([c @ R.T + t for c in clouds(rng)], Gamma(), places @ R.T + t)
    off = np.arccos(np.clip((found.R @ R)[2, 2], -1, 1))
    assert np.degrees(off) < 0.2
    assert off < 3.0 * found.tilt_sigma < np.radians(0.6)
    back = (places @ R.T + t) @ found.R.T + found.t
    assert np.abs(back - (places - MARKERS[0] + [0, 0, 0.007])).max() < 0.012
    assert found.findings == ()


def test_a_mirrored_gamma_is_told_by_the_sensors() -> None:
    rng = np.random.default_rng(0)
    mirrored = [c * [-1, 1, 1] for c in clouds(rng)]
    found = ground_from_gamma(mirrored, Gamma(), sensors(3).centres)
    assert found.R[2] @ [0, 0, 1] > 0.99999
    assert [item.code for item in found.findings] == ["gamma_mirrored"]
    assert np.linalg.det(found.R) > 0


def test_no_gamma_and_impossible_ones_are_named() -> None:
    rng = np.random.default_rng(0)
    places = sensors(3).centres
    with pytest.raises(GammaNotFound, match="0 of 150"):
        ground_from_gamma(clouds(rng), Gamma(0.8, 0.3), places)
    with pytest.raises(GammaNotFound):
        ground_from_gamma([c[:2] for c in clouds(rng)], Gamma(), places)
    with pytest.raises(GammaNotFound):
        ground_from_gamma([], Gamma(), places)
    for long_m, short_m in ((0.4, 0.4), (600.0, 400.0), (0.4, float("nan"))):
        with pytest.raises(GammaInvalid):
            Gamma(long_m, short_m)


def test_the_verb_lays_the_rig_on_the_floor_by_depth(tmp_path: Path) -> None:
    cameras = sensors(3)
    wand, gamma = tmp_path / "wand", tmp_path / "gamma"
    rng = np.random.default_rng(0)
    for folder in (wand, gamma):
        folder.mkdir()
    for name, table in as_tables(waved(cameras, Waving())).items():
        (wand / name).write_text(table)
    write_calibration(tmp_path / "lenses.toml", cameras)
    px = project(cameras, MARKERS)
    depth = (MARKERS @ np.swapaxes(cameras.R, 1, 2) + cameras.t[:, None])[..., 2]
    assert ((px > 0) & (px < SIZE)).all(), "the sensors see the floor"
    for c, name in enumerate(cameras.names):
        rows = ["t_ns;u;v;depth_mm"]
        for moment in range(60):
            uv, d = px[c] + rng.normal(0, 0.12, (3, 2)), 1e3 * depth[c] + rng.normal(0, 2.0, 3)
            rows += [f"{moment * 33_000_000};{u:.3f};{v:.3f};{z:.0f}" for (u, v), z in zip(uv, d, strict=True)]
        (gamma / f"{name}.csv").write_text("\n".join(rows))
    out = tmp_path / "rig.toml"
    command = ["sensors calibrate", str(wand), "--lenses", str(tmp_path / "lenses.toml"), "--trigger", "--gamma"]
    assert main([*command, str(gamma), "--out", str(out)]) == 0
    found = read_calibration(out).cameras
    assert np.abs(found.centres - (cameras.centres - MARKERS[0] + [0, 0, 0.007])).max() < 0.008
    turn = np.degrees(np.arccos(np.clip((np.einsum("cij,cij->c", found.R, cameras.R) - 1) / 2, -1, 1)))
    assert turn.max() < 0.2
    (gamma / "other.csv").write_text((gamma / "sensor1.csv").read_text())
    with pytest.raises(CalibrationMismatch, match="other"):
        gamma_clouds(gamma, found)


def test_rays_of_cameras_without_depth_meet_at_the_gamma(tmp_path: Path) -> None:
    cameras = sensors(3)
    rng = np.random.default_rng(0)
    px = project(cameras, MARKERS)
    for c, name in enumerate(cameras.names):
        rows = []
        for moment in range(40):
            spots = rng.permutation(px[c] + rng.normal(0, 0.2, (3, 2)))
            rows.append(";".join([str(moment * 33_000_000), *(f"{v:.3f}" for v in spots.ravel())]))
        (tmp_path / f"{name}.csv").write_text("\n".join(rows))
    found = ground_from_gamma(gamma_clouds(tmp_path, cameras), Gamma(), cameras.centres)
    assert np.degrees(np.arccos(np.clip(found.R[2, 2], -1, 1))) < 0.2
    assert np.abs(found.markers - MARKERS).max() < 0.003
