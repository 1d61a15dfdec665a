"""Faces of phones: packets built from the published forms, and everything else named once and ridden out."""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.vmc.sender import FACES, IFACIALMOCAP, LIVE_LINK, VmcAddress, read_address
from solver_backend.live.face_source import (
    BLEND_SHAPES,
    REQUEST,
    FaceAssembly,
    FacePacketInvalid,
    ask_phone,
    decode_ifacialmocap,
    decode_live_link,
    face_lines,
)
from solver_backend.live.port import listen
from solver_backend.live.recordings import FaceRecording, Recorder, recording_of

ROOT = Path(__file__).parents[2]
TEXT = (
    "mouthSmile_R-0|eyeLookOut_L-100|mouthUpperUp_L-11|jawOpen-12|browInnerUp-20|trackingStatus-1|"
    "=head#-21.488958,-6.038993,-6.6019735,-0.030653415,-0.10287084,-0.6584072|"
    "rightEye#6.0297494,2.4403017,0.25649446|leftEye#6.034903,-1.6660284,-0.17520553|"
)


def live_link(values, number: int = 600, part: float = 0.25, rate=(60, 1), name: bytes = b"iPhone") -> bytes:
    """Return a packet of Live Link Face as it is published."""
    device = b"A1B2C3D4-E5F6-7890-1234-56789ABCDEF0"
    head = bytes([6]) + struct.pack(">i", len(device)) + device + struct.pack(">i", len(name)) + name
    values = list(values)
    return (
        head
        + struct.pack(">ifii", number, part, *rate)
        + bytes([len(values)])
        + struct.pack(f">{len(values)}f", *values)
    )


def test_live_link_faces_have_every_channel_under_its_name_and_the_apps_time():
    values = np.arange(61) / 61.0
    found = decode_live_link(live_link(values))
    assert found.time == pytest.approx(600.25 / 60.0)
    assert len(BLEND_SHAPES) == len(set(BLEND_SHAPES)) == 52 == len(found.channels)
    for name, place in (
        ("eyeBlinkLeft", 0),
        ("eyeWideRight", 13),
        ("jawOpen", 17),
        ("mouthSmileLeft", 23),
        ("tongueOut", 51),
    ):
        assert found.channels[name] == pytest.approx(values[place])
    assert decode_live_link(live_link([])).channels == {}


def test_text_faces_have_arkits_names_and_shares():
    found = decode_ifacialmocap(TEXT.encode())
    assert found.channels == {
        "mouthSmileRight": 0.0, "eyeLookOutLeft": 1.0, "mouthUpperUpLeft": 0.11, "jawOpen": 0.12, "browInnerUp": 0.2
    }  # fmt: skip
    assert decode_ifacialmocap(b"eyeBlinkLeft&29|jawOpen&4|=head#1,2,3,4,5,6|").channels["eyeBlinkLeft"] == 0.29


@pytest.mark.parametrize(
    ("decode", "packet"),
    [
        (decode_live_link, b""),
        (decode_live_link, bytes([5]) + live_link(np.zeros(61))[1:]),
        (decode_live_link, live_link(np.zeros(61))[:-1]),
        (decode_live_link, live_link(np.zeros(20))),
        (decode_live_link, live_link([np.nan] * 61)),
        (decode_live_link, live_link([1e9] * 61)),
        (decode_live_link, live_link(np.zeros(61), name=b"x" * 300)),
        (decode_live_link, bytes([6]) + struct.pack(">i", -5) + b"abc"),
        (decode_ifacialmocap, b""),
        (decode_ifacialmocap, b"\xff\xfe"),
        (decode_ifacialmocap, b"=head#1,2,3"),
        (decode_ifacialmocap, b"jawOpen-nan|"),
        (decode_ifacialmocap, b"jawOpen-999999|"),
        (decode_ifacialmocap, b"jawOpen|"),
        (decode_ifacialmocap, b"a-1|" * 300),
        (decode_ifacialmocap, b"/VMC/Ext/OK\0,i\0\0\0\0\0\1"),
    ],
)
def test_what_is_no_face_is_refused(decode, packet):
    with pytest.raises(FacePacketInvalid):
        decode(packet)


def frames_of(assembly: FaceAssembly, packets, sender="me", start: float = 0.0) -> list:
    return [f for k, packet in enumerate(packets) for f in assembly.take(packet, sender, start + k / 60.0)]


def test_doubled_and_late_packets_and_a_second_phone_are_named_once_and_left_out():
    assembly = FaceAssembly(LIVE_LINK)
    packets = [live_link(np.full(61, k / 100.0), 600 + k) for k in range(10)]
    order = [0, 1, 1, 2, 4, 3, 5, 5, 6]
    found = frames_of(assembly, [packets[k] for k in order])
    assert [round(100 * f.channels["jawOpen"]) for f in found] == [0, 1, 2, 4, 5, 6]
    assert [f.time for f in found] == pytest.approx([0, 1 / 60, 2 / 60, 4 / 60, 5 / 60, 6 / 60])
    assert not frames_of(assembly, packets[7:9], "other", 0.2)
    assert frames_of(assembly, [live_link(np.zeros(61), 5)], "other", 2.0)
    assert assembly.counts == {"packet_doubled": 2, "packet_late": 1, "second_sender": 2}
    assert [kind for kind, _ in assembly.news] == ["packet_doubled", "packet_late", "second_sender"]


def test_a_face_that_keeps_still_goes_on_as_text_has_no_clock():
    assembly = FaceAssembly(IFACIALMOCAP)
    assert len(frames_of(assembly, [TEXT.encode()] * 5)) == 5 and not assembly.counts


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "good"), [(LIVE_LINK, live_link(np.zeros(61))), (IFACIALMOCAP, TEXT.encode())])
def test_a_hundred_thousand_hostile_packets_change_nothing_and_take_no_memory(scheme, good):
    rng, assembly = random.Random(7), FaceAssembly(scheme)

    def hostile() -> bytes:
        kind, packet = rng.randrange(4), bytearray(good)
        if kind == 0:
            return rng.randbytes(rng.randrange(300))
        if kind == 1:
            return bytes(packet[: rng.randrange(len(packet))])
        for _ in range(rng.randrange(1, 9)):
            packet[rng.randrange(len(packet))] = rng.randrange(256)
        return bytes(packet) * (1 if kind == 2 else rng.randrange(1, 4))

    def run(count: int) -> None:
        for k in range(count):
            for frame in assembly.take(hostile(), "me", k / 60.0):
                assert all(abs(value) < 10.0 for value in frame.channels.values()) and len(frame.channels) <= 256
                assert np.isfinite(frame.time) and frame.time >= 0.0

    run(2_000)
    tracemalloc.start()
    run(2_000)
    before, _ = tracemalloc.get_traced_memory()
    run(96_000)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 20_000
    assert set(assembly.counts) <= {"packet_invalid", "packet_doubled", "packet_late"}
    assert len(assembly.news) <= 3


def test_addresses_have_the_apps_ports():
    assert read_address("livelink://", FACES) == VmcAddress("127.0.0.1", 11111, LIVE_LINK)
    assert str(read_address("ifacialmocap://192.168.1.7", FACES)) == "ifacialmocap://192.168.1.7:49983"


def test_a_phone_is_asked_answers_and_is_asked_again_after_silence(monkeypatch):
    monkeypatch.setattr("solver_backend.live.port._ASK_S", 0.05)
    monkeypatch.setattr("solver_backend.live.port._LOOK_S", 0.02)
    phone = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    phone.bind(("127.0.0.1", 0))
    phone.settimeout(5.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as spare:
        spare.bind(("127.0.0.1", 0))
        port = spare.getsockname()[1]
    asked = []

    def answer() -> None:
        for _ in range(2):
            request, sender = phone.recvfrom(1000)
            asked.append(request)
            phone.sendto(TEXT.encode(), sender)
            time.sleep(0.02)

    threading.Thread(target=answer, daemon=True).start()
    assembly = FaceAssembly(IFACIALMOCAP)
    found = listen(VmcAddress("127.0.0.1", port, IFACIALMOCAP), assembly, ask_phone(*phone.getsockname()))
    faces = []
    for line in face_lines(found):
        faces += [line["face"]] if "face" in line else []
        if len(faces) == 2:
            break
    found.close()
    phone.close()
    assert asked == [REQUEST, REQUEST] and faces[0]["jawOpen"] == 0.12


def test_channels_are_recorded_as_a_table(tmp_path):
    path = tmp_path / "face.csv"
    with Recorder(path, FaceRecording(), overwrite=False) as recorder:
        recorder.add(0.0, {"jawOpen": 0.5, "smile": 1.0})
        recorder.add(0.5, {"jawOpen": 0.25})
    assert path.read_text() == "time,jawOpen,smile\n0.000000,0.5000,1.0000\n0.500000,0.2500,1.0000\n"
    assert not recording_of(path).exists()


def test_what_a_killed_run_left_is_finished_by_the_next_and_a_cut_line_is_left_out(tmp_path):
    path = tmp_path / "face.csv"
    program = (
        "import os, signal\nfrom pathlib import Path\nfrom solver_backend.live.recordings import Recorder\n"
        "from solver_backend.live.recordings import FaceRecording\n"
        f"r = Recorder(Path({str(path)!r}), FaceRecording(), overwrite=False)\nr.add(0.0, dict(jawOpen=0.5))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, env={**os.environ}, check=False)
    assert ended.returncode == -signal.SIGKILL
    with recording_of(path).open("ab") as left:
        left.write(b'[0.1, {"jawO')
    again = Recorder(path, FaceRecording(), overwrite=False)
    again.finish()
    assert again.recovered is not None and again.recovered.read_text().splitlines()[1:] == ["0.000000,0.5000"]


@pytest.mark.parametrize("content", [b"no json\n", b"[1]\n", b"[0, [1]]\n", b'[0, {"a": "b"}]\n'])
def test_a_recording_that_is_none_is_refused_and_kept(tmp_path, content):
    path = tmp_path / "face.csv.recording"
    path.write_bytes(content)
    with pytest.raises(FileDamaged):
        FaceRecording().finish(path, tmp_path / "face.csv")
    assert path.exists()


@pytest.mark.parametrize(
    "options",
    [
        ["livelink://", "--send", "vmc://"],
        ["livelink://", "--record", "a.npz"],
        ["livelink://", "--fast"],
        ["ifacialmocap://:0"],
    ],
)
def test_what_does_not_go_with_a_face_is_refused(options, capsys):
    assert main(["live stream", *options, "--json"]) == 2
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["code"] == "command_line_invalid"


def test_a_run_receives_and_records_what_a_phone_sends(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as spare:
        spare.bind(("127.0.0.1", 0))
        port = spare.getsockname()[1]
    path = tmp_path / "face.csv"
    run = subprocess.Popen(
        [sys.executable, "-m", "solver_backend", "live stream", f"livelink://:{port}", "--record", str(path), "--json"],
        stdout=subprocess.PIPE, cwd=ROOT, text=True,
    )  # fmt: skip
    assert run.stdout is not None
    try:
        assert "listening" in run.stdout.readline()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as phone:
            for number in range(20):
                phone.sendto(live_link(np.full(61, number / 20.0), number), ("127.0.0.1", port))
                time.sleep(0.01)
        lines = []
        while len(lines) < 20:
            lines += [json.loads(run.stdout.readline())]
        run.send_signal(signal.SIGINT)
        result = json.loads(run.communicate(timeout=60)[0].splitlines()[-1])
    finally:
        run.kill()
    assert [line["face"]["jawOpen"] for line in lines] == [number / 20.0 for number in range(20)]
    assert result["event"] == "result" and result["recorded"] == str(path)
    assert len(path.read_text().splitlines()) == 21


def test_packets_that_waited_in_the_buffer_pass_their_own_time() -> None:
    """This process paused for 1.5 s, then reads a burst of 60 frames a second."""
    sender, passed = FaceAssembly(LIVE_LINK), 0.0
    for n in range(150):
        passed = sender.pass_time(n / 60, n / 60 if n < 30 else max(n / 60, 0.5 + 1.5))
    assert passed == pytest.approx(149 / 60, abs=0.01)
