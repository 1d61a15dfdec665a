"""Props in the motion file: written and read back, and refused where they do not fit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.motion_file import MotionFile, read_motion, write_motion
from solver_backend.exchange.npz import read_npz, write_npz
from solver_backend.exchange.props import Prop

FRAMES = 6


def a_prop(name: str, count: int, frames: int = FRAMES) -> Prop:
    rng = np.random.default_rng(count)
    labels = tuple(f"{name} {n}" for n in range(count))
    poses = rng.normal(size=(3, frames, 3))
    return Prop(name, labels, rng.normal(size=(count, 3)), *poses[:2], np.abs(poses[2, :, :2]), np.full(frames, count))


@pytest.fixture
def motion() -> MotionFile:
    props = (a_prop("stick", 3), a_prop("box ü", 5))
    return MotionFile(
        "take", np.zeros((FRAMES, 24, 3)), np.zeros((FRAMES, 3)), np.zeros(10), 50.0, body="neutral",
        joints=np.zeros((FRAMES, 24, 3)), props=props,
    )  # fmt: skip


def test_what_is_written_is_read_back(tmp_path: Path, motion: MotionFile) -> None:
    found = read_motion(write_motion(tmp_path / "motion.npz", motion)).props
    assert [(prop.name, prop.labels) for prop in found] == [(prop.name, prop.labels) for prop in motion.props]
    for one, two in zip(found, motion.props, strict=True):
        np.testing.assert_allclose(one.markers, two.markers, atol=1e-5)
        np.testing.assert_allclose(one.sigma, two.sigma, atol=1e-6)
        np.testing.assert_array_equal(one.seen, two.seen)


def test_props_of_other_frames_are_refused(tmp_path: Path, motion: MotionFile) -> None:
    with pytest.raises(MotionInvalid, match="7 frames, but 6 are expected"):
        replace(motion, props=(a_prop("long", 3, 7),))
    path = write_motion(tmp_path / "motion.npz", motion)
    arrays = read_npz(path, lambda _: True)
    for name, value, message in (
        ("prop_points", None, "without prop_points"), ("prop_seen", np.zeros((2, 5)), "prop_seen has shape"),
        ("prop_transl", np.full((2, FRAMES, 3), np.nan), "not finite"),
    ):  # fmt: skip
        changed = {key: array for key, array in arrays.items() if key != name}
        changed |= {} if value is None else {name: value}
        with pytest.raises(MotionInvalid, match=message):
            read_motion(write_npz(tmp_path / f"{name}.npz", changed))


def test_they_are_exported_as_json(tmp_path: Path, motion: MotionFile, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = write_motion(tmp_path / "motion.npz", motion), tmp_path / "props.json"
    assert main(["motion props", str(path), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["props"] == ["stick", "box ü"]
    plain = json.loads(out.read_text(encoding="utf-8"))
    stick = plain["props"][0]
    np.testing.assert_allclose(stick["transl"], motion.props[0].transl, atol=1e-6)
    assert list(stick["markers"]) == ["stick 0", "stick 1", "stick 2"] and plain["fps"] == 50.0
    assert main(["motion props", str(path), "--out", str(out)]) == 3  # it is there
    bare = write_motion(tmp_path / "bare.npz", replace(motion, props=()))
    assert main(["motion props", str(bare), "--out", str(tmp_path / "none.json")]) == 3
    assert "has no props" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "number"), [("seen", np.nan), ("seen", 300.0), ("seen", -3.0), ("transl", 1e30), ("rotvec", 1e30)]
)
def test_a_prop_that_cannot_be_is_named(name: str, number: float, motion: MotionFile) -> None:
    prop = motion.props[0]
    values = np.asarray(getattr(prop, name), np.float64).copy()
    values.flat[1] = number
    with pytest.raises(MotionInvalid, match=f"{name} of the prop 'stick'"):
        replace(prop, **{name: values})
