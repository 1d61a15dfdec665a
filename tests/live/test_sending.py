"""Poses arrive at a receiver where the motion has them, whether it is there from the start or not."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.cli.main import main
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.vmc.humanoid import BONE_OF
from solver_backend.exchange.vmc.sender import VmcAddress, read_address
from solver_backend.io.native.motion_file import write_motion
from solver_backend.live.sending import PoseSender, replayed_poses, rest_joints
from tests.support.bvh_texts import known_motion, write_bvh
from tests.support.short_motion import short_motion
from tests.support.vmc_receiver import Avatar, Receiver


@pytest.fixture
def receiver():
    found = Receiver()
    yield found
    found.close()


def test_a_replayed_motion_arrives_frame_by_frame_where_its_joints_are(tmp_path: Path, receiver, capsys):
    motion = short_motion(30)
    write_motion(tmp_path / "walk.npz", motion)
    lines = tmp_path / "poses.jsonl"
    assert main(["live stream", str(tmp_path / "walk.npz"), "--send", receiver.address, "--lines", str(lines)]) == 0
    packets = receiver.close()
    assert len(packets) == 30 and "sent 30" in capsys.readouterr().out
    poses = [json.loads(line) for line in lines.read_text(encoding="utf-8").splitlines()]
    assert [pose["t"] for pose in poses] == pytest.approx([k / 60 for k in range(30)], abs=1e-6)
    for number, packet in enumerate(packets):
        avatar = Avatar().receive(packet)
        assert avatar.time == pytest.approx(number / 60, abs=1e-6)
        for j, name in enumerate(motion.body_layout.joints):
            if name in BONE_OF:
                x, y, z = motion.joints[number, j]
                assert np.abs(avatar.world(BONE_OF[name])[1] - (-x, z, -y)).max() < 1e-4


def test_another_programs_clip_is_sent_on_our_body(tmp_path: Path, receiver):
    known = known_motion(load_body(), np.zeros(10), frames=12)
    clip = write_bvh(tmp_path / "clip.bvh", known)
    arguments = ["live stream", str(clip), "--send", receiver.address, "--lines", str(tmp_path / "poses.jsonl")]
    assert main(arguments) == 0
    packets = receiver.close()
    assert len(packets) == 12
    pose = [json.loads(line) for line in (tmp_path / "poses.jsonl").read_text(encoding="utf-8").splitlines()]
    assert pose[-1]["t"] == pytest.approx(11 / known.fps, abs=1e-3)
    wrists = [Avatar().receive(packet).world(BONE_OF["left_wrist"])[1] for packet in packets]
    hips = [Avatar().receive(packet).world(BONE_OF["pelvis"])[1] for packet in packets]
    own = np.asarray(known.posed.joints)[:, SMPL_HANDS.numbers("left_wrist", "pelvis")]
    reached = np.linalg.norm(np.array(wrists) - np.array(hips), axis=1)
    assert np.abs(reached - np.linalg.norm(own[:, 0] - own[:, 1], axis=1)).max() < 0.01


def test_what_the_fit_of_another_programs_clip_found_is_reported(tmp_path: Path, receiver, capsys):
    known = known_motion(load_body(), np.zeros(10), frames=3)
    raised = replace(known, posed=replace(known.posed, joints=np.asarray(known.posed.joints) + [0.0, 0.0, 0.4]))
    clip = write_bvh(tmp_path / "clip.bvh", raised)
    lines = str(tmp_path / "poses.jsonl")
    assert main(["live stream", str(clip), "--send", receiver.address, "--lines", lines]) == 0
    assert "was lowered" in capsys.readouterr().err
    assert main(["motion convert", str(clip), "--out", str(tmp_path / "motion.npz")]) == 0
    assert "was lowered" in capsys.readouterr().out


def test_fingers_are_sent_where_a_motion_has_them(tmp_path: Path, receiver):
    motion = short_motion(4, fingers=True)
    write_motion(tmp_path / "hands.npz", motion)
    arguments = ["live stream", str(tmp_path / "hands.npz"), "--lines", str(tmp_path / "poses.jsonl")]
    assert main([*arguments, "--send", receiver.address]) == 0
    packets = receiver.close()
    for number, packet in enumerate(packets):
        avatar = Avatar().receive(packet)
        assert len(avatar.local) == 1 + 52
        for j, name in enumerate(SMPL_HANDS.joints):
            x, y, z = motion.joints[number, j]
            assert np.abs(avatar.world(BONE_OF[name])[1] - (-x, z, -y)).max() < 1e-4, name
    assert len(packets) == 4


def test_the_rest_joints_of_a_motion_are_its_bodys():
    motion = short_motion(2)
    assert np.allclose(rest_joints(motion), load_body().rest_joints(motion.betas)[:24], atol=1e-9)


def test_nothing_is_sent_unless_it_is_asked_for(tmp_path: Path, monkeypatch):
    def forbidden(*_: object) -> None:
        raise AssertionError("a socket was opened")

    monkeypatch.setattr("solver_backend.exchange.vmc.sender.socket.socket", forbidden)
    write_motion(tmp_path / "walk.npz", short_motion(3))
    assert main(["live stream", str(tmp_path / "walk.npz"), "--lines", str(tmp_path / "poses.jsonl"), "--fast"]) == 0
    with pytest.raises(AssertionError, match="a socket was opened"):
        PoseSender(VmcAddress(), lambda: (load_body().layout, np.zeros((24, 3))))


@pytest.mark.parametrize("options", [["--record", "a.c3d"], ["--subject", "s.npz"], ["--send", "udp://x"]])
def test_what_does_not_go_with_a_motion_is_refused(tmp_path: Path, options, capsys):
    write_motion(tmp_path / "walk.npz", short_motion(2))
    options = [str(tmp_path / word) if word.endswith(("c3d", "npz")) else word for word in options]
    assert main(["live stream", str(tmp_path / "walk.npz"), *options, "--json"]) == 2
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["code"] == "command_line_invalid"


def test_a_receiver_that_is_away_is_named_once_and_the_run_goes_on():
    gone = Receiver()
    gone.close()
    motion = short_motion(40)
    with PoseSender(read_address(gone.address), lambda: (motion.body_layout, rest_joints(motion))) as sender:
        lines = list(sender.watched(replayed_poses(motion, paced=False)))
    events = [line for line in lines if "event" in line]
    assert [line["event"] for line in events] == ["receiver_away"] and len(lines) == 41
    refused = sender.summary()["refused"]
    assert isinstance(refused, int) and refused > 0


def test_the_receivers_clock_never_runs_back(receiver):
    motion = short_motion(3)
    lines = [*replayed_poses(motion, paced=False)]
    lines = [{**line, "t": 1.7e9 + t} for line, t in zip(3 * lines, [0, 1, 2, -5, -4, -3, 100, 101, 102], strict=True)]
    with PoseSender(read_address(receiver.address), lambda: (motion.body_layout, rest_joints(motion))) as sender:
        list(sender.watched(lines))
    times = [Avatar().receive(packet).time for packet in receiver.close()]
    assert times == pytest.approx([0, 1, 2, 2, 3, 4, 107, 108, 109])


def test_a_shape_that_is_known_by_now_changes_the_bones(receiver):
    shapes = iter([np.zeros(10), np.full(10, 2.0)])
    body, motion = load_body(), short_motion(2)
    line = next(replayed_poses(motion, paced=False))
    with PoseSender(read_address(receiver.address), lambda: (body.layout, body.rest_joints(next(shapes)))) as sender:
        list(sender.watched([line, line, {"event": "shape", "t": 0.0, "message": "known"}, line]))
    first, second, third = (Avatar().receive(packet).offset["LeftLowerLeg"] for packet in receiver.close())
    assert np.array_equal(first, second) and np.abs(third - first).max() > 0.003


@pytest.mark.slow
def test_sending_takes_no_more_memory_with_time(receiver):
    motion = short_motion(2)
    line = next(replayed_poses(motion, paced=False))
    with PoseSender(read_address(receiver.address), lambda: (motion.body_layout, rest_joints(motion))) as sender:
        for _ in sender.watched([line] * 50):
            pass
        receiver.close()
        tracemalloc.start()
        grown = []
        for number in range(4000):
            for _ in sender.watched([{**line, "t": float(number)}]):
                pass
            if number % 1000 == 999:
                grown.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert grown[-1] < grown[1] + 2000, grown  # by then caches of the interpreter are full
