"""One run of the command line: CPU time, memory, and the longest CPU time between two progress lines."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_LOOK_S = 0.05
ROOT = Path(__file__).resolve().parents[3]


@dataclass
class Run:
    """Time and memory of a run."""

    code: int = 0
    """Exit code."""
    cpu_s: float = 0.0
    peak_mb: float = 0.0
    silence_s: float = 0.0
    """Longest CPU time in seconds without a progress line."""
    silent_after: str = ""
    """Stage of the last line before that."""
    ended: str = ""
    """Message of the error, if the run ended with one."""
    cpu_by_stage: dict[str, float] = field(default_factory=dict)
    """CPU seconds from each stage's line to the next."""

    def line(self) -> str:
        """Return all values as one line."""
        stages = ", ".join(
            f"{name} {s:.1f}" for name, s in sorted(self.cpu_by_stage.items(), key=lambda kv: -kv[1])[:6]
        )
        return (
            f"exit code {self.code}, {self.cpu_s:.1f} s of CPU, {self.peak_mb:,.0f} MB, at most {self.silence_s:.1f} s "
            f"silent (after {self.silent_after or 'the start'}); {stages}{'; ' + self.ended if self.ended else ''}"
        )


def run_measured(arguments: Sequence[str], folder: Path) -> Run:
    """Run a Python module, named by the first word, with ``--json`` in a folder to its end."""
    process = subprocess.Popen(
        [sys.executable, "-m", *arguments, "--json"], cwd=folder, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    found, over = Run(), threading.Event()
    looking = threading.Thread(target=_watch_memory, args=(process.pid, found, over))
    looking.start()
    try:
        _follow(process, found)
    finally:
        over.set()
        looking.join()
    _, status, usage = os.wait4(process.pid, 0)
    found.code, found.cpu_s = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
    process.returncode = found.code
    return found


def _follow(process: subprocess.Popen[str], found: Run) -> None:
    """Read the events until the stream ends."""
    assert process.stdout is not None
    stage, last = "", 0.0
    for text in process.stdout:
        now, event = cpu_seconds(process.pid), json.loads(text)
        found.cpu_by_stage[stage] = found.cpu_by_stage.get(stage, 0.0) + now - last
        if now - last > found.silence_s:
            found.silence_s, found.silent_after = now - last, stage
        last, stage = now, _stage_of(event, found, stage)


def _stage_of(event: dict[str, Any], found: Run, stage: str) -> str:
    if event["event"] == "error":
        found.ended = event["message"]
    return f"{event['stage']}" if event["event"] == "progress" else stage


def cpu_seconds(pid: int) -> float:
    """Return the CPU seconds of a process and of its ended children, or the last known value if it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _watch_memory(pid: int, found: Run, over: threading.Event) -> None:
    while not over.wait(_LOOK_S):
        try:
            status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
        except OSError:
            return
        if peak := re.search(r"VmHWM:\s+(\d+)", status):
            found.peak_mb = max(found.peak_mb, int(peak[1]) / 1024)
