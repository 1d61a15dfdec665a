"""Clips of suits, markerless programs, AMASS and Blender onto our body, and what is refused of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.body.body import Body, load_body
from solver_backend.cli.main import main
from solver_backend.exchange.errors import FileDamaged, MotionInvalid, NonFiniteData
from solver_backend.exchange.skeleton_file import SkeletonFile, read_skeleton, write_skeleton
from solver_backend.fitters.motion_import.import_motion import import_motion, shape_from_lengths
from solver_backend.io.motions.foreign_skeleton import read_foreign_clip
from solver_backend.io.native.motion_file import read_motion
from tests.support.bvh_texts import KnownMotion, known_motion, write_bvh
from tests.support.mvnx_texts import R_STAGE_BODY, write_mvnx

BETAS = np.array([0.8, -0.5, 0.6, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
LIMBS = [1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21]
SHARED = Path(__file__).parents[3] / "shared" / "data"


@pytest.fixture(scope="module")
def body() -> Body:
    return load_body()


@pytest.fixture(scope="module")
def known(body: Body) -> KnownMotion:
    return known_motion(body, BETAS, 40)


def farthest_m(path: Path, body: Body, known: KnownMotion, **options: str) -> float:
    source, roles, _ = read_foreign_clip(path, **options)
    done = import_motion(source, roles, body, keep_height=True)
    return float(np.linalg.norm(done.motion.joints - known.posed.joints, axis=-1)[:, LIMBS].max())


def skeleton_of(known: KnownMotion, scale: float = 1.0) -> SkeletonFile:
    names = known.names[:24]
    rest = scale * known.rest[:24] @ R_STAGE_BODY.T
    turns = known.posed.G[:, :24] @ R_STAGE_BODY.T
    joints = scale * known.posed.joints[:, :24]
    return SkeletonFile("walk", names, tuple(known.parents[:24]), rest, joints, turns, known.fps, {})


def test_a_suits_recording_comes_back(tmp_path: Path, body: Body, known: KnownMotion) -> None:
    assert farthest_m(write_mvnx(tmp_path / "take.mvnx", known), body, known) < 0.004


@pytest.mark.parametrize(
    ("edits", "error", "text"),
    [
        ({"tpose": "npose", "identity": "other"}, FileDamaged, "no T-pose"),
        ({"normal": "other"}, MotionInvalid, "no recorded frames"),
        ({'label="LeftToe"': 'label="Sword"'}, FileDamaged, "Unknown segments: Sword"),
        ({'frameRate="30"': ""}, FileDamaged, "no frame rate"),
        ({"<frames>": "<frames>&"}, FileDamaged, "not XML"),
        ({"<orientation>1.000000": "<orientation>nan"}, NonFiniteData, "'orientation' contains NaN"),
        ({"<orientation>1.000000": "<orientation>"}, FileDamaged, "instead of 88"),
        ({"<orientation>1.000000": "<orientation>1e200"}, NonFiniteData, "'orientation' contains 1e\\+200"),
    ],
)
def test_what_is_wrong_with_a_suits_file_is_named(tmp_path, known, edits, error, text) -> None:
    path = write_mvnx(tmp_path / "take.mvnx", known, **edits)
    with pytest.raises(error, match=text):
        read_foreign_clip(path)


@pytest.mark.parametrize("scale", [1.0, 100.0, 17.7])
def test_a_skeleton_from_blender_comes_back_in_any_unit(tmp_path, body, known, scale) -> None:
    path = tmp_path / "clip.npz"
    write_skeleton(path, skeleton_of(known, scale))
    assert farthest_m(path, body, known) < 0.004


def test_skeleton_files_that_are_none_are_named(tmp_path: Path, known: KnownMotion) -> None:
    whole = skeleton_of(known)
    write_skeleton(tmp_path / "whole.npz", whole)
    joints = whole.joints.copy()
    joints[3, 2] = np.nan
    cases = [
        ({"joints": joints}, NonFiniteData, "'joints' contains NaN"),
        ({"joints": whole.joints[:0], "turns": whole.turns[:0]}, MotionInvalid, "no frames"),
        ({"parents": np.array((1, *whole.parents[1:]))}, MotionInvalid, "not a tree"),
        ({"parents": np.full(len(whole.names), np.inf)}, NonFiniteData, "'parents' contains NaN or infinite"),
        ({"fps": np.array(0.0)}, NonFiniteData, "frame rate"),
        ({"names": np.array(["neck"] * len(whole.names))}, MotionInvalid, "Several joints are called 'neck'"),
        ({"turns": whole.turns + 1e6}, MotionInvalid, "are not rotations"),
    ]
    with np.load(tmp_path / "whole.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    for k, (changes, error, text) in enumerate(cases):
        np.savez(tmp_path / f"{k}.npz", **(arrays | changes))
        with pytest.raises(error, match=text):
            read_skeleton(tmp_path / f"{k}.npz")


def test_a_skeleton_without_size_is_named(tmp_path: Path, known: KnownMotion) -> None:
    whole = skeleton_of(known)
    write_skeleton(tmp_path / "flat.npz", replace(whole, rest=1e-170 * whole.rest, roles={}))
    with pytest.raises(MotionInvalid, match="units large"):
        read_foreign_clip(tmp_path / "flat.npz")


def test_a_clip_that_leaves_the_world_or_is_no_clip_is_named(tmp_path: Path, known: KnownMotion) -> None:
    far = skeleton_of(known)
    write_skeleton(tmp_path / "far.npz", replace(far, joints=far.joints + 1e6))
    with pytest.raises(MotionInvalid, match="from the origin"):
        read_foreign_clip(tmp_path / "far.npz")
    for name, text in (("clip.fbx", "read through Blender"), ("clip.bip", r"not supported \(\.bip\)")):
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(MotionInvalid, match=text):
            read_foreign_clip(tmp_path / name)
    (tmp_path / "points.csv").write_bytes(b"x")
    with pytest.raises(MotionInvalid) as refused:
        read_foreign_clip(tmp_path / "points.csv")
    assert refused.value.hint == "To solve points without rotations, use manifold solve points.csv"


def test_a_rest_pose_that_is_a_frame_of_a_clip_is_reported(tmp_path: Path, known: KnownMotion, capsys: Any) -> None:
    whole = skeleton_of(known)
    rest = whole.rest.copy()
    rest[[7, 10]] += rest[4] + [0.0, 0.4, 0.05] - rest[7]
    for name, skeleton, count in (("bent", replace(whole, rest=rest), 1), ("straight", whole, 0)):
        write_skeleton(tmp_path / f"{name}.npz", skeleton)
        assert (
            main(
                ["motion convert", str(tmp_path / f"{name}.npz"), "--out", str(tmp_path / f"{name}_out.npz"), "--json"]
            )
            == 0
        )
        problems = json.loads(capsys.readouterr().out.splitlines()[-1])["problems"]
        assert sum("not a T-pose or A-pose: the left shin" in problem for problem in problems) == count


def test_a_shape_of_ours_is_found_exactly_and_other_lengths_are_drawn_to_the_mean(body: Body) -> None:
    found = shape_from_lengths(body, body.rest_joints(BETAS)[:24])
    assert np.abs(body.rest_joints(found) - body.rest_joints(BETAS))[LIMBS].max() < 5e-4
    rest = body.rest_joints(BETAS)[:24].copy()
    rest[[18, 20]] += [0.12, 0.0, 0.0]
    strange = shape_from_lengths(body, rest)
    assert np.abs(strange).max() < 10.0


def test_poses_of_amass_are_taken_over(tmp_path: Path, body: Body, capsys: Any) -> None:
    rng = np.random.default_rng(0)
    poses = 0.2 * rng.normal(size=(12, 156))
    np.savez(tmp_path / "amass.npz", poses=poses, trans=rng.normal(size=(12, 3)), betas=rng.normal(size=16),
             mocap_framerate=120.0, gender="female")  # fmt: skip
    out = tmp_path / "out.npz"
    assert main(["motion convert", str(tmp_path / "amass.npz"), "--out", str(out), "--json"]) == 0
    assert "mean shape" in json.loads(capsys.readouterr().out.splitlines()[-1])["notes"][0]
    motion = read_motion(out)
    assert motion.num_frames == 12 and motion.fps == 120.0 and not motion.betas.any()
    assert np.allclose(motion.body_pose[:, :63], poses[:, 3:66], atol=1e-6)


def test_segments_of_a_markerless_program(tmp_path: Path, body: Body) -> None:
    path = SHARED / "cases" / "markers" / "c3d_rotations" / "C3DRotationExample.c3d"
    if not path.is_file():
        pytest.skip("The shared data are not here.")
    source, roles, _ = read_foreign_clip(path)
    done = import_motion(source, roles, body)
    assert source.num_frames == 340 and len(roles) == 18
    assert max(off for role, off in done.distances_mm.items() if not role.endswith(("toe", "head"))) < 10.0
    with pytest.raises(FileDamaged, match="no segment rotations"):
        read_foreign_clip(SHARED / "cases" / "markers" / "bts_labels" / "bts.c3d")


def test_bvh_goes_the_same_way(tmp_path: Path, body: Body, known: KnownMotion) -> None:
    assert farthest_m(write_bvh(tmp_path / "clip.bvh", known), body, known) < 0.004
