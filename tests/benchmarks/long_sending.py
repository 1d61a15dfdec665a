"""Send a motion to a receiver on this machine for minutes: lost packets, CPU time per frame, growth of memory.

``python -m tests.benchmarks.long_sending --minutes 10`` replays a motion at 60 frames per second repeatedly, sends it
by the VMC protocol, and counts the packets that another process receives. This runs only on Linux, because memory is
read from /proc.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import socket
import struct
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

from solver_backend.exchange.vmc.sender import VmcAddress
from solver_backend.live.sending import PoseSender, replayed_poses, rest_joints
from tests.support.short_motion import short_motion

FPS = 60.0
_TIME_AT = 16 + 4 + 20 + 4 + 16
"""Offset of the seconds in a bundle: after its head, OK, and the address and tags of T."""


def main() -> int:
    """Send, count, and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--fingers", action="store_true", help="a motion with fingers")
    asked = parser.parse_args()
    seconds = 60.0 * asked.minutes
    here, there = multiprocessing.Pipe()
    receiver = multiprocessing.Process(target=_receive, args=(there,), daemon=True)
    receiver.start()
    motion = short_motion(600, FPS, fingers=asked.fingers)
    lines, cpu_s, frames, memory = 0, 0.0, 0, []
    with PoseSender(VmcAddress("127.0.0.1", here.recv()), lambda: (motion.body_layout, rest_joints(motion))) as sender:
        for line in replayed_poses(motion, repeat=True):
            before = time.process_time()
            lines += sum("pose" in sent for sent in sender.watched([line]))
            cpu_s += time.process_time() - before
            frames = line["frame"] + 1
            if lines % 600 == 0:
                memory.append(_resident_mb())
            if line["t"] >= seconds:
                break
    here.send("end")
    received, in_order = here.recv()
    late = frames - lines
    sys.stdout.write(
        f"{lines} sent ({late} frames were late), {received} received, {in_order} in order; "
        f"{1e3 * cpu_s / lines:.3f} ms of CPU a frame; "
        f"memory {memory[1]:.1f} MB after 20 s, {memory[-1]:.1f} MB at the end\n"
    )
    return int(received != lines)


def _receive(pipe: Connection) -> None:
    there = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    there.bind(("127.0.0.1", 0))
    there.settimeout(0.5)
    pipe.send(there.getsockname()[1])
    received, in_order, last = 0, 0, -1.0
    while True:
        try:
            packet = there.recv(65536)
        except TimeoutError:
            if pipe.poll():
                break
            continue
        (at,) = struct.unpack_from(">f", packet, _TIME_AT)
        received, in_order, last = received + 1, in_order + (at > last), at
    pipe.send((received, in_order))


def _resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    raise SystemExit(main())
