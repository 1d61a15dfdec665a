"""Read job files: check all keys and values, and convert them to the solver's types."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from solver_backend.exchange.body_choice import is_path
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.job_file import VERSION, JobFile, start_of
from solver_backend.exchange.reading_settings import ROWS as READING
from solver_backend.exchange.setting import is_list, settings_of_class
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.io.files import read_json
from solver_backend.types import JointSet

_TYPES = {"switch": bool, "number": (int, float), "text": str, "choice": str, "texts": list, "range": list}
_TYPES |= {"file": str, "Path": str, "Path | None": str, "bool": bool, "tuple[str, ...]": list}
"""JSON type for each kind of setting, and for each type of a field of ``JobFile``."""
PATHS: dict[str, Callable[[str], bool]] = {
    name: is_path if row.kind == "name_or_file" else bool
    for name, row in settings_of_class(SolveSettings).items()
    if row.kind in ("file", "name_or_file")
}
"""Functions that tell paths from other texts, for the settings that may be paths."""


@dataclass(frozen=True)
class Resolve(FrameRange):
    """A frame range of an earlier motion to solve again."""

    motion: Path = field(kw_only=True)  # Motion file of the earlier solve.


@dataclass(frozen=True)
class Job(JobFile):
    """A job file with its values in the solver's types."""

    joint_set: JointSet | None = field(default=None, kw_only=True)
    settings: SolveSettings = field(default_factory=SolveSettings)
    resolve: Resolve | None = None

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], folder: Path = Path()) -> Job:
        """Build a job from the plain values of a job file.

        Args:
            values: ``version``, ``capture``, ``out`` and any other field. ``settings`` has the settings of the solve.
            folder: base of relative paths.

        Raises:
            JobInvalid: the version differs, a key is unknown or missing, or a value has the wrong type.
        """
        known = {"version", *cls.__dataclass_fields__}
        if unknown := sorted(set(values) - known):
            hint = f"Known keys: {', '.join(sorted(known))}."
            raise JobInvalid(f"Unknown key {', '.join(unknown)}.", where="job", hint=hint)
        if (version := values.get("version")) != VERSION:
            message = f"The job has version {version!r}, but {VERSION} is needed."
            raise JobInvalid(message, where="job", hint=f'Write "version": {VERSION}.')
        if missing := [key for key in ("capture", "out") if not values.get(key)]:
            what = f"The job has no {' and '.join(missing)}."
            raise JobInvalid(what, where="job", hint="Specify both as file paths.")
        own = {item.name: str(item.type) for item in fields(JobFile) if item.name not in READING}
        kinds = own | {name: row.kind for name, row in READING.items()}
        types: dict[str, Any] = {name: _TYPES[kind] for name, kind in kinds.items() if kind in _TYPES}
        given = {name: value for name, kind in types.items() if (value := _typed(values, name, kind)) is not None}
        convert: dict[str, Callable[[Any], Any]] = {
            name: folder.joinpath for name, kind in own.items() if kind.startswith("Path")
        }
        convert |= {
            name: lambda text: str(folder / text) if text else "" for name, row in READING.items() if row.kind == "file"
        }
        convert["start_from"] = lambda values: tuple(_beside(str(value), folder) for value in values)
        convert |= {"fps": positive_fps, "joint_set": joint_set_named, "frames": _frames}
        plain = {name: convert.get(name, lambda value: value)(value) for name, value in given.items()}
        read: dict[str, Any] = {name: tuple(value) if is_list(value) else value for name, value in plain.items()}
        return cls(
            settings=settings_of(_typed(values, "settings", dict) or {}, folder),
            resolve=_resolve(_typed(values, "resolve", dict), folder),
            **read,
        )

    @classmethod
    def read(cls, path: Path | str, *, allow_outside: bool = True) -> Job:
        """Read a job file. Relative paths start at its folder.

        Args:
            allow_outside: True if the job may write outside this folder.

        Raises:
            JobInvalid: see ``from_dict``, or the job writes outside its folder without permission.
        """
        values = read_json(path)
        if not isinstance(values, dict):
            raise JobInvalid("The job file does not contain a JSON object.", where=str(path))
        folder = Path(path).parent
        job = cls.from_dict(values, folder)
        for name, output in (("out", job.out), ("report", job.report)):
            if output is not None and not allow_outside and not output.resolve().is_relative_to(folder.resolve()):
                hint = "If you trust the job file, add --allow-outside."
                raise JobInvalid(
                    f"The job writes outside its own folder: {name} = {output}.", where=str(path), hint=hint
                )
        return job

    def reading(self) -> dict[str, Any]:
        """Return the job's values for the keyword arguments of ``load_capture``."""
        return {name: getattr(self, name) for name in READING} | {"sync": self.settings.sync}


def _beside(text: str, folder: Path) -> str:
    """Resolve the path in ``[CAMERA=]FILE`` relative to a folder."""
    camera, file = start_of(text, folder)
    return f"{camera}={file}" if camera else str(file)


def joint_set_named(name: str) -> JointSet:
    """Return the joint set with this name, or raise ``JobInvalid`` with the known names."""
    try:
        return JointSet(name)
    except ValueError as error:
        names = ", ".join(item.value for item in JointSet)
        raise JobInvalid(f"There is no joint set '{name}'.", where="joint_set", hint=f"Known sets: {names}.") from error


def positive_fps(value: float) -> float:
    """Return the frame rate, or raise ``JobInvalid`` unless it is positive and finite."""
    if not 0 < value <= sys.float_info.max:
        raise JobInvalid(f"The frame rate must be a positive number, not {value}.", where="fps")
    return float(value)


def settings_of(values: Mapping[str, Any], folder: Path) -> SolveSettings:
    """Build solve settings from plain values. Relative paths start at the folder."""
    settings = SolveSettings.from_dict(values)
    given = {name: getattr(settings, name) for name in PATHS}
    if any("\0" in text for text in given.values()):
        what = "A path in the settings contains the character U+0000, which no path can contain."
        raise JobInvalid(what, where="settings")
    files: dict[str, Any] = {name: str(folder / text) for name, text in given.items() if PATHS[name](text)}
    return replace(settings, **files)


def _frames(values: list[Any]) -> tuple[int, int]:
    if len(values) != 2 or not all(isinstance(value, int) and not isinstance(value, bool) for value in values):
        raise JobInvalid(f"'frames' is {values!r}, but the first and the last frame are expected.", where="frames")
    return values[0], values[1]


def _resolve(values: Mapping[str, Any] | None, folder: Path) -> Resolve | None:
    if values is None:
        return None
    motion = _typed(values, "motion", str)
    if motion is None:
        raise JobInvalid("`resolve` has no `motion`.", where="resolve", hint="Specify the earlier motion.")
    _typed(values, "pins", list)
    _typed(values, "contacts", list)
    try:
        given = FrameRange.from_dict({key: value for key, value in values.items() if key != "motion"})
    except OverflowError as error:
        raise JobInvalid("A pinned pose contains a number that is too large.", where="resolve") from error
    return Resolve(given.first, given.last, given.pins, given.contacts, motion=folder / motion)


def _typed(values: Mapping[str, Any], key: str, kind: Any) -> Any:
    """Check the type of a key's value and return it, or None if the key is missing. True and False are not numbers."""
    value = values.get(key)
    if value is None or (isinstance(value, kind) and (kind is bool or not isinstance(value, bool))):
        return value
    names = {str: "text", bool: "true or false", dict: "an object", list: "a list"}
    raise JobInvalid(f"{key} is {value!r}, but {names.get(kind, 'a number')} is expected.", where="job")
