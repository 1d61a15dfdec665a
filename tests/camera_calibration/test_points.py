"""Cameras from clicked points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.camera_calibration.adjustment.bundle import Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import build_cameras, lens_of
from solver_backend.camera_calibration.extrinsics.together import (
    Clicks,
    calibrate_by_points,
    clicks_evidence,
    read_clicks,
)
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import CalibrationInvalid, FileDamaged
from tests.support.carried_board import ring

FLOOR = [(x, y, 0.0) for x in (-0.6, 0.0, 0.7) for y in (-0.5, 0.1, 0.6)]
BOX = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.4, 0.4) for z in (0.0, 0.9)]


def clicked(places: list, noise_px: float = 0.5) -> tuple:
    cameras = ring(3)
    px = project(cameras, np.array(places))
    px = px + np.random.default_rng(0).normal(0, noise_px, px.shape)
    names = [f"p{i}" for i in range(len(places))]
    by_camera = {
        c: {n: tuple(p) for n, p in zip(names, rows, strict=True)} for c, rows in zip(cameras.names, px, strict=True)
    }
    clicks = Clicks(by_camera, dict(zip(names, places, strict=True)))
    return cameras, clicks, {n: lens_of(cameras, i) for i, n in enumerate(cameras.names)}


@pytest.mark.parametrize("places", [FLOOR, BOX], ids=["in a plane", "in space"])
def test_cameras_stand_where_the_points_say(places: list) -> None:
    cameras, clicks, lenses = clicked(places)
    found = calibrate_by_points(clicks, lenses)
    assert np.linalg.norm(found.cameras.centres - cameras.centres, axis=1).max() < 0.015
    assert found.findings == ()


def test_clicks_are_fitted_to_the_end() -> None:
    _, clicks, lenses = clicked(FLOOR, noise_px=5.0)
    found = calibrate_by_points(clicks, lenses).cameras
    cameras = build_cameras(found.names, [lenses[name] for name in found.names], found.R, found.t)
    evidence = clicks_evidence(cameras, clicks)
    again = adjust(cameras, evidence.bodies, evidence.seen, Unknowns(np.ones(3, bool)), robust_scale=3.0, tolerance=0.0)
    assert np.linalg.norm(again.cameras.centres - found.centres, axis=1).max() < 2e-5


def test_points_of_unknown_place_help_and_a_false_click_is_named() -> None:
    cameras, clicks, lenses = clicked(BOX + [(0.2, 0.1, 0.5), (-0.3, 0.2, 0.3)])
    known = {n: p for n, p in clicks.places.items() if n not in ("p8", "p9")}
    px = {c: dict(points) for c, points in clicks.px.items()}
    px["cam2"]["p3"] = px["cam2"]["p3"][0] + 60.0, px["cam2"]["p3"][1]
    found = calibrate_by_points(Clicks(px, known), lenses)
    assert found.notes == (diagnostic("calibration_evidence", evidence="clicks", count=10, known=8),)
    clicks_far = [(item.values["point"], item.where.cameras) for item in found.findings if item.code == "click_far"]
    assert ("p3", ("cam2",)) in clicks_far
    assert np.linalg.norm(found.cameras.centres - cameras.centres, axis=1).max() < 0.04


def test_bad_tables_and_too_few_points_are_named(tmp_path: Path) -> None:
    _, clicks, lenses = clicked(FLOOR)
    table = tmp_path / "clicks.csv"
    rows = [f"{p},{c},{u},{v}" for c, points in clicks.px.items() for p, (u, v) in points.items()]
    rows += [f"{p},world,{x},{y},{z}" for p, (x, y, z) in clicks.places.items()]
    table.write_text("\n".join(["point,camera,x,y,z", *rows]))
    read = read_clicks(table)
    assert read == clicks
    few = replace(clicks, px={c: dict(list(points.items())[:3]) for c, points in clicks.px.items()})
    with pytest.raises(CalibrationInvalid, match="3 points with known positions"):
        calibrate_by_points(few, lenses)
    one = replace(clicks, px=dict(list(clicks.px.items())[:1]))
    with pytest.raises(CalibrationInvalid, match="clicked in 1 cameras.*at least two cameras"):
        calibrate_by_points(one, lenses)
    line = [(0.1 * i, 0.0, 0.0) for i in range(8)]
    with pytest.raises(CalibrationInvalid, match="not in a line"):
        calibrate_by_points(clicked(line)[1], lenses)
    table.write_text("p1,cam1,12\n")
    with pytest.raises(FileDamaged, match="Line 1"):
        read_clicks(table)


def test_clicks_that_no_picture_has_are_named(tmp_path: Path) -> None:
    table = tmp_path / "clicks.csv"
    table.write_text("p1,cam1,12,1e300\n")
    with pytest.raises(FileDamaged, match="Line 1"):
        read_clicks(table)


def test_clicks_where_the_lens_shows_nothing_are_named() -> None:
    _, clicks, lenses = clicked(BOX)
    folded = {name: replace(lens, distortion=np.r_[-9.0, np.zeros(7)]) for name, lens in lenses.items()}
    with pytest.raises(CalibrationInvalid, match="was clicked outside the lens's image area"):
        calibrate_by_points(clicks, folded)
