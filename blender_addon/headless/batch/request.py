"""A request to process a batch: its captures, settings, limits and workers."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..._exchange.errors import MocapError
from ..._exchange.json_file import read_json_file
from ..._exchange.reading_settings import ROWS as READING
from ...errors import BatchInvalid, TakeTooLarge, TakeTooSlow
from ...solving.child_memory import resident_mb
from ...solving.take_paths import MARKER_SUFFIXES, is_session, trials_below
from .record import fingerprint
from .work import take_name


@dataclass(frozen=True)
class TakeLimits:
    """Limits of the solver for one take. None means no limit."""

    seconds: float | None = None  # Total time for reading and solving, in seconds.
    memory_mb: float | None = None  # Resident memory of the solver process in megabytes.

    def require_possible(self) -> None:
        """Check that this system can measure memory, if there is a memory limit.

        Raises:
            BatchInvalid: this system cannot report the memory of a process.
        """
        # On Windows, the Python of a virtual environment is a launcher, and the solver runs in its child process.
        if self.memory_mb is not None and (sys.platform == "win32" or resident_mb(os.getpid()) is None):
            hint = "Omit --take-memory."
            raise BatchInvalid("This system does not report a process's memory.", hint=hint)


class TakeWatch:
    """Compares the processes of one take with its time and memory limits."""

    def __init__(self, limits: TakeLimits) -> None:
        self._limits, self._start = limits, time.monotonic()

    def over_limit(self, pid: int) -> MocapError | None:
        """Return an error if a process exceeds a limit, otherwise None."""
        seconds, most_mb = self._limits.seconds, self._limits.memory_mb
        if seconds is not None and time.monotonic() - self._start > seconds:
            message = f"The take took longer than {seconds:g} s and was stopped."
            return TakeTooSlow(message, hint="Raise --take-seconds, or solve the take alone.")
        if most_mb is not None and (used_mb := resident_mb(pid) or 0.0) > most_mb:
            message = f"The solver used {used_mb:.0f} MB for the take, more than the allowed {most_mb:g} MB"
            return TakeTooLarge(f"{message}, and was stopped.", hint="Raise --take-memory, or cut the take.")
        return None


_SHARED_KEYS = frozenset({"version", "strict", "settings", *READING})  # Keys allowed in a batch's job file.
_MARKERS_ALONE = (".c3d", ".trc")  # Suffixes of marker recordings. Other tables are ambiguous.


@dataclass(frozen=True)
class BatchRequest:
    """Settings of a batch, which solves every capture in a folder."""

    captures: Path  # A session, or a folder of captures (``.npz`` files, marker recordings and subfolders).
    out: Path  # Folder for the results. It gets a folder per take and the summary.
    job: Path | None = None  # Job file with the settings for reading and solving. It names no capture and no output.
    bake: bool = False  # Write a Blender file of each take.
    render: bool = False  # Write a video and a contact sheet of each take.
    formats: tuple[str, ...] = ()  # Export formats for each take.
    body: Path | None = None  # Body file, or None for the body that each motion was solved for.
    python: Path | None = None  # Python in which to solve, or None for this one.
    marker_formats: tuple[str, ...] = ()  # Formats in which to write the cleaned markers of marker takes.
    limits: TakeLimits = field(default_factory=TakeLimits)
    """Limits of the solver for each take. They do not change the keys of finished takes."""
    strict: bool = False  # Reject takes whose solve has warnings, whatever the job file says.
    accept: tuple[str, ...] = ()  # Codes of faults to accept, in addition to those in the job file.

    def choices(self) -> dict[str, Any]:
        """Return the settings that affect a take's results, as plain values."""
        shared = _shared(self.job)
        shared |= {"strict": True} if self.strict else {}
        if self.accept:
            settings = shared.get("settings") or {}
            accepted = [*settings.get("accept", ()), *self.accept]
            shared["settings"] = {**settings, "accept": list(dict.fromkeys(accepted))}
        plain = {"bake": self.bake, "render": self.render, "formats": self.formats, "settings": shared}
        plain |= {"markers": self.marker_formats} if self.marker_formats else {}
        return {**plain, "body": str(self.body), "python": str(self.python)}


@dataclass(frozen=True)
class Spread:
    """Settings that distribute a batch over workers, and that define when the batch ends."""

    scheduler: str = ""  # Address of a Dask scheduler, or the path of its file, or "" for none.
    workers: int = 0  # Takes processed in parallel on this machine, or 0 for one after another in this process.
    watch: bool = False  # Also process captures that arrive later.
    settled_s: float = 5.0  # A capture is complete once it has not changed for this many seconds.
    idle_s: float | None = None  # Stop watching if nothing arrives for this many seconds. None means never.
    stretches: bool = False  # Also let the cluster's workers solve segments of long takes.
    patience_s: float = 60.0  # Seconds to wait for a lost scheduler or for workers.


def find_captures(request: BatchRequest) -> list[Path]:
    """Return the folder's captures sorted by name, without hidden files and results.

    Raises:
        BatchInvalid: there are no captures, or two of them would have the same name.
    """
    if not request.captures.is_dir():
        hint = "Specify the capture folder."
        raise BatchInvalid("There is no such folder.", where=str(request.captures), hint=hint)
    found = captures_in(request)
    names = [take_name(path) for path in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or not found:
        message = (
            f"Several captures have the same name: {', '.join(twice)}." if twice else "The folder contains no captures."
        )
        hint = f"Captures are .npz files, {', '.join(MARKER_SUFFIXES)} and folders with unique names."
        raise BatchInvalid(message, where=str(request.captures), hint=hint)
    return found


def captures_in(request: BatchRequest) -> list[Path]:
    """Return the folder's captures sorted by name, or [] if the folder is not readable.

    A folder is a session if it contains settings or a calibration for its trials, or nested folders. A session's
    captures are its trials and its marker recordings.
    """
    try:
        paths = sorted(request.captures.iterdir())
        trials = trials_below(request.captures) if is_session(request.captures) else []
    except OSError:
        return []
    if any(trial.parent != request.captures for trial in trials) or (trials and any(map(_is_of_a_session, paths))):
        return [*trials, *(path for path in paths if path.is_file() and path.suffix.lower() in _MARKERS_ALONE)]
    out = request.out.resolve()
    return [
        path
        for path in paths
        if (path.is_dir() or path.suffix.lower() in (".npz", *MARKER_SUFFIXES))
        and not path.name.startswith(".")
        and path.resolve() != out
    ]


def _is_of_a_session(path: Path) -> bool:
    name = path.name.lower()
    return name == "config.toml" or (path.is_dir() and name.startswith("calib"))


def _shared(path: Path | None) -> dict[str, Any]:
    """Read and check the job file that applies to all takes of a batch."""
    if path is None:
        return {}
    try:
        values = read_json_file(path)
    except MocapError as error:
        raise BatchInvalid(f"The job file cannot be read: {error}", where=str(path)) from error
    unknown = sorted(set(values) - _SHARED_KEYS) if isinstance(values, dict) else ["a list or a single value"]
    if unknown:
        hint = f"It may contain {', '.join(sorted(_SHARED_KEYS))}."
        raise BatchInvalid(f"A batch's job file cannot contain {', '.join(unknown)}.", where=str(path), hint=hint)
    for name, row in READING.items():
        if (value := values.get(name)) is not None and not row.accepts(value):
            raise _not_valid(f"{name} is {value!r}, but {row.expected} is expected.", path)
    settings = values.get("settings") or {}
    if not isinstance(settings, dict):
        raise _not_valid("settings must be an object with settings.", path)
    accepted = settings.get("accept") or []
    if not isinstance(accepted, list) or not all(isinstance(code, str) for code in accepted):
        raise _not_valid("accept must be a list of codes.", path)
    if not isinstance(values.get("strict", False), bool):
        raise _not_valid("strict must be true or false.", path)
    return values


def _not_valid(why: str, path: Path) -> BatchInvalid:
    return BatchInvalid(f"The batch's job file is not valid: {why}", where=str(path))


class Listed:
    """A source of captures or shots that are all known from the start."""

    closed = True

    def __init__(self, items: list[Path]) -> None:
        self._waiting = items

    def arrived(self) -> list[Path]:
        """Return all items on the first call and none afterwards."""
        found, self._waiting = self._waiting, []
        return found

    def notes(self) -> list[str]:
        """Return []. A list skips no items, so it has no notes."""
        return []


class Watched:
    """A source of captures that arrive in a folder. A capture is returned once its files no longer change.

    If two captures have the same name, only the first is processed, and the other is reported.

    Args:
        settled_s: a capture is complete if its file names, sizes and times do not change for this many seconds.
        idle_s: seconds to wait for more captures, or None to wait for ever.
        poll_s: seconds between two scans of the folder.
    """

    def __init__(
        self, request: BatchRequest, settled_s: float = 5.0, idle_s: float | None = None, poll_s: float = 1.0
    ) -> None:
        self._request = request
        self._settled_s, self._idle_s, self._poll_s = settled_s, idle_s, poll_s
        self._seen: dict[Path, tuple[str, float]] = {}
        self._given: dict[Path, str] = {}
        self._looked = -poll_s
        self._last = time.monotonic()
        self._doubled: dict[str, str] = {}

    @property
    def closed(self) -> bool:
        """True once nothing has arrived or changed for ``idle_s`` seconds."""
        return self._idle_s is not None and time.monotonic() - self._last > self._idle_s

    def arrived(self) -> list[Path]:
        """Return the captures that have arrived or changed since the last call."""
        now = time.monotonic()
        if now - self._looked < self._poll_s:
            return []
        self._looked, found = now, []
        names = {take_name(path): path for path in self._given}
        for path in captures_in(self._request):
            state = self._state(path)
            if state is None or self._given.get(path) == state:
                continue
            if self._seen.get(path, ("", 0.0))[0] != state:
                self._seen[path] = state, now
            self._last = now
            if now - self._seen[path][1] < self._settled_s:
                continue
            self._given[path] = state
            other = names.setdefault(take_name(path), path)
            if other == path:
                found.append(path)
            else:
                self._doubled[str(path)] = f"{path.name} is skipped, because {other.name} has the same name."
        return found

    def notes(self) -> list[str]:
        """Return notes about captures that are skipped because another has the same name."""
        return list(self._doubled.values())

    def _state(self, path: Path) -> str | None:
        try:
            return fingerprint(path, {})
        except (OSError, MocapError):
            return None
