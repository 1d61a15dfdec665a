"""The job file as the solver reads it: every key known, every value checked and in the solver's types."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from solver_backend.exchange.body_choice import is_path
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.job_file import VERSION, JobFile
from solver_backend.exchange.reading_settings import ROWS as READING
from solver_backend.exchange.setting import settings_of_class
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.io.files import read_json
from solver_backend.types import JointSet

_TYPES: dict[str, type | tuple[type, ...]] = {
    "switch": bool, "number": (int, float), "text": str, "choice": str, "texts": list, "range": list,
}  # fmt: skip
"""In a job file, by the kind of a setting."""
PATHS = {
    name: is_path if row.kind == "name_or_file" else bool
    for name, row in settings_of_class(SolveSettings).items()
    if row.kind in ("file", "name_or_file")
}
"""Settings that may be paths, and the test of whether a text is one."""


@dataclass(frozen=True)
class Resolve:
    """What is solved again."""

    motion: Path  # Motion file of the earlier solve.
    stretch: FrameRange  # Its frames, and the poses they must pass through.

    def as_dict(self) -> dict[str, object]:
        """Return plain values."""
        return {"motion": str(self.motion), **self.stretch.as_dict()}


@dataclass(frozen=True)
class Job(JobFile):
    """A job file with its values in the solver's types."""

    joint_set: JointSet | None = field(default=None, kw_only=True)
    settings: SolveSettings = field(default_factory=SolveSettings)
    resolve: Resolve | None = None

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], folder: Path = Path()) -> Job:
        """Build a job from a job file's plain values.

        Args:
            values: ``version``, ``capture``, ``out`` and any other field; ``settings`` holds those of a solve.
            folder: what relative paths are relative to.

        Raises:
            JobInvalid: the version is another one, a key is unknown or missing, or a value is of the wrong type.
        """
        known = {"version", *cls.__dataclass_fields__}
        unknown = sorted(set(values) - known)
        if unknown:
            raise JobInvalid(
                f"Unknown key {', '.join(unknown)}.", where="job", hint=f"Known keys: {', '.join(sorted(known))}."
            )
        if values.get("version") != VERSION:
            raise JobInvalid(
                f"The job has version {values.get('version')!r}; {VERSION} is read.",
                where="job",
                hint=f'Write "version": {VERSION}.',
            )
        missing = [key for key in ("capture", "out") if not values.get(key)]
        if missing:
            raise JobInvalid(
                f"The job lacks {' and '.join(missing)}.", where="job", hint="Give both as paths of files."
            )
        report, subject, labels, start = (_typed(values, key, str) for key in ("report", "subject", "labels", "start"))
        return cls(
            capture=folder / _typed(values, "capture", str),
            out=folder / _typed(values, "out", str),
            report=None if report is None else folder / report,
            overwrite=bool(_typed(values, "overwrite", bool)),
            strict=bool(_typed(values, "strict", bool)),
            subject=None if subject is None else folder / subject,
            start=None if start is None else folder / start,
            labels=None if labels is None else folder / labels,
            settings=settings_of(_typed(values, "settings", dict) or {}, folder),
            resolve=_resolve(_typed(values, "resolve", dict), folder),
            **_reading(values),
        )

    @classmethod
    def read(cls, path: Path | str) -> Job:
        """Read a job file; relative paths in it are relative to its folder.

        Raises:
            FileMissing, FileDamaged: it is not there or is not JSON.
            JobInvalid: see ``from_dict``.
        """
        values = read_json(path)
        if not isinstance(values, dict):
            raise JobInvalid("The job file does not hold a JSON object.", where=str(path))
        return cls.from_dict(values, Path(path).parent)

    def reading(self) -> dict[str, Any]:
        """Return the arguments that reading the capture takes."""
        return {name: getattr(self, name) for name in READING} | {"sync": self.settings.sync}

    def as_dict(self) -> dict[str, object]:
        """Return the job as plain values, which ``from_dict`` reads back."""
        return {**super().as_dict(), "settings": asdict(self.settings)}


def joint_set_named(name: str) -> JointSet:
    """Return the joint set of this name.

    Raises:
        JobInvalid: there is none; the message lists those there are.
    """
    try:
        return JointSet(name)
    except ValueError as error:
        names = ", ".join(item.value for item in JointSet)
        raise JobInvalid(f"There is no joint set '{name}'.", where="joint_set", hint=f"Known sets: {names}.") from error


def positive_fps(value: float) -> float:
    """Return a frame rate that can be one.

    Raises:
        JobInvalid: it is not a positive, finite number.
    """
    if not 0 < value <= sys.float_info.max:
        raise JobInvalid(f"The frame rate must be a positive number, not {value}.", where="fps")
    return float(value)


def settings_of(values: Mapping[str, Any], folder: Path) -> SolveSettings:
    """Return the settings of plain values, with whole paths.

    Args:
        values: the job's settings.
        folder: what the paths of a body file, a layout and a noise map are relative to.

    Raises:
        JobInvalid: a key is unknown, a type wrong or a value impossible.
    """
    settings = SolveSettings.from_dict(values)
    given = {name: getattr(settings, name) for name in PATHS}
    if any("\0" in text for text in given.values()):
        raise JobInvalid(
            "A path of the settings holds the character U+0000, which is not possible in a path.", where="settings"
        )
    return replace(settings, **{name: str(folder / text) for name, text in given.items() if PATHS[name](text)})


def _reading(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return how a capture is read, of a job file's values, in the solver's types; without what is not given."""
    given = {name: _typed(values, name, _TYPES[row.kind]) for name, row in READING.items()}
    given = {name: value for name, value in given.items() if value is not None}
    special = {"fps": positive_fps, "joint_set": joint_set_named, "frames": _frames}
    plain = {name: special[name](value) if name in special else value for name, value in given.items()}
    return {name: tuple(value) if isinstance(value, list) else value for name, value in plain.items()}


def _frames(values: list[Any]) -> tuple[int, int]:
    if len(values) != 2 or not all(isinstance(value, int) and not isinstance(value, bool) for value in values):
        raise JobInvalid(f"'frames' is {values!r}; the first and the last frame are expected.", where="frames")
    return values[0], values[1]


def _resolve(values: Mapping[str, Any] | None, folder: Path) -> Resolve | None:
    if values is None:
        return None
    motion = _typed(values, "motion", str)
    if motion is None:
        raise JobInvalid("resolve lacks motion.", where="resolve", hint="It is the file of the earlier solve.")
    _typed(values, "pins", list)
    try:
        return Resolve(folder / motion, FrameRange.from_dict({k: v for k, v in values.items() if k != "motion"}))
    except OverflowError as error:
        raise JobInvalid("A pinned pose holds a number that no float can hold.", where="resolve") from error


def _typed(values: Mapping[str, Any], key: str, kind: type | tuple[type, ...]) -> Any:
    """Return the value of a key or None, after checking its type (true and false are no numbers)."""
    value = values.get(key)
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if value is None or (isinstance(value, kinds) and (bool in kinds or not isinstance(value, bool))):
        return value
    names = {str: "text", bool: "true or false", dict: "an object", list: "a list"}
    raise JobInvalid(f"{key} is {value!r}; {names.get(kinds[0], 'a number')} is expected.", where="job")
