"""What a batch is asked for: the captures of a folder, how they are solved, and what is made of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..._exchange.errors import MocapError
from ..._exchange.json_file import read_json_file
from ..._exchange.reading_settings import ROWS as READING
from ...errors import BatchInvalid
from ...solving.take_paths import MARKER_SUFFIXES, is_session, trials_below
from .limits import TakeLimits
from .work import Plain, take_name

_SHARED_KEYS = frozenset({"version", "strict", "settings", *READING})
"""Keys of a batch's job file."""

_MARKERS_ALONE = (".c3d", ".trc")
"""Recordings of markers by their ending, where tables may be anything."""


@dataclass(frozen=True)
class BatchRequest:
    """What to do with every capture of a folder."""

    captures: Path
    """Folder; each file ``.npz``, each recording of markers and each folder in it is a capture; or a session."""
    out: Path
    """Folder of the results: one folder a take, and the summary."""
    job: Path | None = None
    """Job file without capture and out: how to read and to solve."""
    bake: bool = False
    """Write a Blender file of each take."""
    render: bool = False
    """Write a video and a contact sheet of each take."""
    formats: tuple[str, ...] = ()
    """Formats to export each take to."""
    body: Path | None = None
    """Body file; None for the one each motion is solved for."""
    python: Path | None = None
    """Python to solve with; None for this one."""
    marker_formats: tuple[str, ...] = ()
    """Formats to write the cleaned markers of takes of markers to."""
    limits: TakeLimits = field(default_factory=TakeLimits)
    """Of the solver for each take; a take that was done within others is not done again."""
    strict: bool = False
    """Refuse takes whose solves have warnings, whatever the job file states."""
    accept: tuple[str, ...] = ()
    """Codes of faults that are accepted beside those of the job file."""

    def plain(self) -> Plain:
        """Return the request for another process or machine: plain values, paths from the root."""
        paths = {name: getattr(self, name) for name in ("captures", "out", "body")}
        whole = {name: None if path is None else str(path.resolve()) for name, path in paths.items()}
        return {
            **whole, "bake": self.bake, "render": self.render, "formats": list(self.formats),
            "marker_formats": list(self.marker_formats), "python": None if self.python is None else str(self.python),
            "limits": [self.limits.seconds, self.limits.memory_mb],
        }  # fmt: skip

    @classmethod
    def from_plain(cls, values: Plain) -> BatchRequest:
        """Return the request that ``plain`` has written; the job file's settings travel as choices."""
        body, python = (Path(values[name]) if values[name] else None for name in ("body", "python"))
        return cls(
            Path(values["captures"]), Path(values["out"]), None, values["bake"], values["render"],
            tuple(values["formats"]), body, python, tuple(values["marker_formats"]), TakeLimits(*values["limits"]),
        )  # fmt: skip

    def choices(self) -> dict[str, Any]:
        """Return what decides what is made of a capture, as plain values."""
        shared = {**_shared(self.job), **({"strict": True} if self.strict else {})}
        if self.accept:
            settings = shared.get("settings") or {}
            accepted = [*settings.get("accept", ()), *self.accept]
            shared["settings"] = {**settings, "accept": list(dict.fromkeys(accepted))}
        plain = {"bake": self.bake, "render": self.render, "formats": self.formats, "settings": shared}
        plain |= {"markers": self.marker_formats} if self.marker_formats else {}
        return {**plain, "body": str(self.body), "python": str(self.python)}


@dataclass(frozen=True)
class Spread:
    """Who does the takes of a batch, and until when."""

    scheduler: str = ""
    """Address of a Dask scheduler, or the path of its file; "" for none."""
    workers: int = 0
    """Takes at a time on this machine; 0 does one after the other in this process."""
    watch: bool = False
    """Go on with what arrives in the folder."""
    settled_s: float = 5.0
    """A capture has arrived when it has not changed for so long."""
    idle_s: float | None = None
    """Stop watching when nothing has arrived for so long; None for never."""
    stretches: bool = False
    """Let the cluster's workers solve stretches of long takes, too."""
    patience_s: float = 60.0
    """How long to wait for a scheduler that is gone, and for workers."""


def find_captures(request: BatchRequest) -> list[Path]:
    """Return the captures of the folder by name, hidden files and the results left out.

    Raises:
        BatchInvalid: there are none, or two would share a name.
    """
    if not request.captures.is_dir():
        raise BatchInvalid(
            "There is no such folder.", where=str(request.captures), hint="Name the folder of the captures."
        )
    found = captures_in(request)
    names = [take_name(path) for path in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or not found:
        raise BatchInvalid(
            f"Two captures are called {', '.join(twice)}." if twice else "The folder holds no captures.",
            where=str(request.captures),
            hint=f"Captures are files .npz, {', '.join(MARKER_SUFFIXES)} and folders, each with a name of its own.",
        )
    return found


def captures_in(request: BatchRequest) -> list[Path]:
    """Return what the folder holds of captures, by name; nothing where it cannot be looked into.

    Of a session, which has settings or a calibration for its trials or keeps them deeper, its trials and recordings of
    markers.
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
    """Return what a batch's job file states.

    Raises:
        BatchInvalid: it cannot be read, or names a capture of its own.
    """
    if path is None:
        return {}
    try:
        values = read_json_file(path)
    except MocapError as error:
        raise BatchInvalid(f"The job file cannot be read: {error}", where=str(path)) from error
    unknown = sorted(set(values) - _SHARED_KEYS) if isinstance(values, dict) else ["anything but an object"]
    if unknown:
        raise BatchInvalid(
            f"A batch's job file cannot hold {', '.join(unknown)}.",
            where=str(path),
            hint=f"It may hold {', '.join(sorted(_SHARED_KEYS))}.",
        )
    for name, row in READING.items():
        if (value := values.get(name)) is not None and not row.accepts(value):
            raise _not_valid(f"{name} is {value!r}; {row.expected} is expected.", path)
    settings = values.get("settings") or {}
    if not isinstance(settings, dict):
        raise _not_valid("settings is a list or a value; an object of settings is expected.", path)
    accepted = settings.get("accept") or []
    if not isinstance(accepted, list) or not all(isinstance(code, str) for code in accepted):
        raise _not_valid("accept is a list of codes.", path)
    if not isinstance(values.get("strict", False), bool):
        raise _not_valid("strict is true or false.", path)
    return values


def _not_valid(why: str, path: Path) -> BatchInvalid:
    return BatchInvalid(f"The batch's job file is not valid: {why}", where=str(path))
