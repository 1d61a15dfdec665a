"""Poses that come live become a motion of one rate, and nothing that happens takes what came before."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.hands import FIRST_FINGER
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.exchange.errors import FileDamaged, OutputNotWritable
from solver_backend.exchange.motion_file import FLAG_UNSEEN
from solver_backend.exchange.so3 import matrix_from_rotvec
from solver_backend.exchange.vmc.sender import VmcAddress
from solver_backend.io.native.motion_file import read_motion
from solver_backend.live.recordings import PoseRecorder, PosesRecording, Recorder, rate_of, recording_of
from solver_backend.live.sending import PoseSender, replayed_poses, rest_joints
from tests.support.full_disk import full_disk
from tests.support.short_motion import short_motion

ROOT = Path(__file__).parents[2]
FRAMES = 40


@pytest.fixture(scope="module")
def motion():
    return short_motion(FRAMES)


def vectors_of(motion) -> np.ndarray:
    return np.concatenate([motion.global_orient, motion.body_pose], axis=1).reshape(motion.num_frames, -1, 3)


def recorder(path: Path, motion) -> PoseRecorder:
    form = PosesRecording("vmc://test", lambda: (load_body(), motion.betas))
    return Recorder(path, form, overwrite=False)


def record(path: Path, motion, times: np.ndarray) -> PoseRecorder:
    found = recorder(path, motion)
    for time, rotvec, transl in zip(times, vectors_of(motion), motion.transl, strict=False):
        found.add(float(time), rotvec, transl)
    return found


def degrees_off(a, b) -> float:
    A, B = (matrix_from_rotvec(vectors_of(motion)) for motion in (a, b))
    return float(np.degrees(np.linalg.norm(A - B, axis=(-1, -2)) / 2**0.5).max())


def test_even_poses_are_the_motion(tmp_path, motion):
    with record(tmp_path / "take.npz", motion, 5.0 + np.arange(FRAMES) / 60.0):
        pass
    read = read_motion(tmp_path / "take.npz")
    assert read.fps == 60.0 and read.num_frames == FRAMES and os.listdir(tmp_path) == ["take.npz"]
    assert read.body_layout == SMPL  # no finger was ever turned
    assert degrees_off(read, motion) < 1e-3 and np.abs(read.joints - motion.joints).max() < 1e-5
    assert np.allclose(read.betas, motion.betas, atol=1e-6) and read.provenance["source"] == "vmc://test"
    assert read.flags is not None and not read.flags.any()


def test_fingers_are_recorded_from_where_they_begin(tmp_path):
    motion = short_motion(FRAMES, fingers=True)
    with recorder(tmp_path / "take.npz", motion) as found:
        for k, (rotvec, transl) in enumerate(zip(vectors_of(motion), motion.transl, strict=True)):
            found.add(k / 60.0, rotvec if k >= 10 else np.concatenate([rotvec[:22], np.zeros((2, 3))]), transl)
    read = read_motion(tmp_path / "take.npz")
    assert read.body_layout.joints == SMPL_HANDS.joints and read.body == load_body().id
    assert not vectors_of(read)[:10, FIRST_FINGER:].any()
    turned = matrix_from_rotvec(vectors_of(read)[10:]) @ np.swapaxes(
        matrix_from_rotvec(vectors_of(motion)[10:]), -1, -2
    )
    assert np.degrees(np.linalg.norm(turned - np.eye(3), axis=(-1, -2)).max() / 2**0.5) < 0.1
    assert np.abs(read.joints[10:] - motion.joints[10:]).max() < 1e-4


def test_poses_that_come_unevenly_or_are_lost_lie_where_they_were_at_the_frames_times(tmp_path, motion):
    jitter = np.random.default_rng(0).uniform(-0.004, 0.004, FRAMES)
    times = np.sort(np.arange(FRAMES) / 60.0 + jitter)
    true = short_motion(FRAMES * 20, 1200.0)  # the same motion, finely
    rows = np.clip(np.rint(times * 1200).astype(int), 0, FRAMES * 20 - 1)
    kept = np.delete(np.arange(FRAMES), [7, 20])
    found = recorder(tmp_path / "take.npz", motion)
    for k in kept:
        found.add(rows[k] / 1200.0, vectors_of(true)[rows[k]], true.transl[rows[k]])
    found.finish()
    read = read_motion(tmp_path / "take.npz")
    first = rows[0]
    at = first + 20 * np.arange(read.num_frames)
    expected = matrix_from_rotvec(vectors_of(true)[at[at < len(true.transl)]])
    got = matrix_from_rotvec(vectors_of(read))[: len(expected)]
    assert read.fps == 60.0 and read.num_frames >= FRAMES - 1
    assert np.degrees(np.linalg.norm(got - expected, axis=(-1, -2)).max()) < 0.3


def test_a_gap_is_bridged_and_flagged_and_a_long_silence_is_cut(tmp_path, motion):
    times = np.arange(FRAMES) / 60.0
    times[20:] += 1.0
    times[30:] += 3600.0
    record(tmp_path / "take.npz", motion, times).finish()
    read = read_motion(tmp_path / "take.npz")
    assert read.flags is not None and read.num_frames == FRAMES + 60 + 59
    assert 90 < int((read.flags & FLAG_UNSEEN > 0).sum()) < 119
    assert not read.flags[:20].any() and not read.flags[-9:].any()


def test_a_single_pose_and_none_at_all(tmp_path, motion):
    record(tmp_path / "one.npz", motion, np.zeros(1)).finish()
    assert read_motion(tmp_path / "one.npz").num_frames == 1
    recorder(tmp_path / "none.npz", motion).finish()
    assert os.listdir(tmp_path) == ["one.npz"]


@pytest.mark.parametrize(("rate", "found"), [(59.6, 60), (29.97, 30), (61.0, 60), (37.2, 37), (1000.0, 1000)])
def test_rates_are_usual_ones(rate, found):
    assert rate_of(np.arange(50) / rate) == found


def test_what_a_killed_run_left_is_finished_by_the_next(tmp_path, motion):
    path = tmp_path / "take.npz"
    killed = record(path, motion, np.arange(FRAMES) / 60.0)
    os.write(killed._file.handle, b"half a pose")
    with pytest.raises(OutputNotWritable, match="Another process is recording"):
        recorder(path, motion)
    os.close(killed._file.handle)  # as the system does
    with recorder(path, motion) as found:
        assert found.recovered == tmp_path / "take_recovered_1.npz"
    assert degrees_off(read_motion(tmp_path / "take_recovered_1.npz"), motion) < 1e-3
    assert os.listdir(tmp_path) == ["take_recovered_1.npz"]


def test_a_full_disk_costs_the_poses_that_do_not_fit(tmp_path, motion):
    found = recorder(tmp_path / "take.npz", motion)
    with full_disk(16000):
        for k in range(FRAMES):
            found.add(k / 60.0, vectors_of(motion)[k], motion.transl[k])
    with pytest.raises(OutputNotWritable, match="could not be written"):
        found.finish()
    assert 0 < read_motion(tmp_path / "take.npz").num_frames < FRAMES


@pytest.mark.parametrize("content", [b"nonsense\n", b'{"format": 1}\n', b"[]\n"])
def test_a_recording_that_is_none_is_refused_and_kept(tmp_path, content):
    (tmp_path / "a.npz.recording").write_bytes(content)
    with pytest.raises(FileDamaged):
        PosesRecording().finish(tmp_path / "a.npz.recording", tmp_path / "a.npz")
    assert os.listdir(tmp_path) == ["a.npz.recording"]


@pytest.mark.parametrize("fingers", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_run_receives_and_records_what_another_sends(tmp_path, fingers):
    motion = short_motion(FRAMES, fingers=fingers)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as spare:
        spare.bind(("127.0.0.1", 0))
        address = VmcAddress("127.0.0.1", spare.getsockname()[1])
    path, lines = tmp_path / "take.npz", tmp_path / "poses.jsonl"
    command = [sys.executable, "-m", "solver_backend", "live stream", str(address), "--record", str(path), "--json"]
    process = subprocess.Popen([*command, "--lines", str(lines)], stdout=subprocess.PIPE, cwd=ROOT)
    assert process.stdout is not None
    try:
        while not lines.exists() or b"listening" not in lines.read_bytes():
            assert process.poll() is None
        with PoseSender(address, lambda: (motion.body_layout, rest_joints(motion))) as sender:
            for _ in sender.watched(replayed_poses(motion)):
                pass
        while lines.read_bytes().count(b'"frame"') < FRAMES:
            assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        result = json.loads(process.stdout.read().splitlines()[-1])
        assert process.wait(timeout=60) == 0
    finally:
        process.kill()
        process.stdout.close()
    read = read_motion(path)
    assert result["recorded"] == str(path) and not recording_of(path).exists() and result["not_used"] == {}
    assert read.num_frames == FRAMES and read.fps == 60.0
    assert read.body_layout.num_joints == (52 if fingers else 24)
    assert degrees_off(read, motion) < 0.05
    assert np.abs(read.joints - motion.joints).max() < 5e-4
