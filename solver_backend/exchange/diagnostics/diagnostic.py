"""A diagnostic: what was found, how grave it is, where, with which figures, and what was done about it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from numbers import Integral
from typing import Any, TypedDict

from .entry import Severity
from .table import TABLE

Frames = tuple[tuple[int, int], ...]
"""First and last frame, included, of one or more stretches."""


class Remedy(StrEnum):
    """What the program did about it; the value is the name written to files."""

    REPORTED = "reported"
    """Nothing was changed."""
    REPAIRED = "repaired"
    """The detections, labels or the camera were corrected."""
    EXCLUDED = "excluded"
    """The data are not used there."""
    BRIDGED = "bridged"
    """The motion was interpolated."""


@dataclass(frozen=True)
class Where:
    """What a diagnostic concerns; empty fields mean that it is no one in particular."""

    file: str = ""
    """Path or name of a file."""
    frames: Frames = ()
    """Stretches of frames."""
    cameras: tuple[str, ...] = ()
    """Names of cameras; the first is the one that is at fault, where others are named for comparison."""
    markers: tuple[str, ...] = ()
    """Labels of markers."""
    joints: tuple[str, ...] = ()
    """Names of joints or keypoints."""
    person: str = ""
    """Name of a person."""

    def as_dict(self) -> dict[str, object]:
        """Return plain JSON values of the fields that are not empty."""
        found = {item.name: getattr(self, item.name) for item in fields(self)}
        plain: dict[str, object] = {
            key: value if isinstance(value, str) else list(value) for key, value in found.items() if value
        }
        return {**plain, "frames": [list(run) for run in self.frames]} if self.frames else plain


class DiagnosticValues(TypedDict):
    """A diagnostic as plain JSON values."""

    code: str
    severity: str
    where: dict[str, object]
    values: dict[str, object]
    remedy: str


@dataclass(frozen=True)
class Diagnostic:
    """One thing that was found."""

    code: str
    """Its name in the table; a file of another version may hold one that the table lacks."""
    severity: Severity
    """How grave it is."""
    where: Where = Where()
    """What it concerns."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Figures and names by the words of the table: plain JSON values."""
    remedy: Remedy = Remedy.REPORTED
    """What was done."""

    def as_dict(self) -> DiagnosticValues:
        """Return plain JSON values, which ``read_diagnostics`` reads back."""
        return {
            "code": self.code, "severity": self.severity.value, "where": self.where.as_dict(),
            "values": dict(self.values), "remedy": self.remedy.value,
        }  # fmt: skip


def diagnostic(
    code: str, *, severity: Severity | None = None, remedy: Remedy = Remedy.REPORTED, file: str = "",
    frames: Iterable[tuple[int, int]] = (), cameras: Sequence[str] = (), markers: Sequence[str] = (),
    joints: Sequence[str] = (), person: str = "", **values: Any,
) -> Diagnostic:  # fmt: skip
    """Return a diagnostic of the table.

    Args:
        code: key of ``TABLE``.
        severity: the table's if None.
        remedy: what was done.
        file, frames, cameras, markers, joints, person: see ``Where``.
        values: what the table's sentence names; numbers are kept to six digits.

    Raises:
        KeyError: the table has no such code.
    """
    where = Where(
        file, tuple((int(a), int(b)) for a, b in frames), tuple(cameras), tuple(markers), tuple(joints), person
    )
    plain = {key: _plain(value) for key, value in values.items()}
    return Diagnostic(code, severity or TABLE[code].severity, where, plain, remedy)


def _plain(value: Any) -> Any:
    """Return a value as JSON has it."""
    if isinstance(value, str | bool):
        return value
    if isinstance(value, Integral):  # NumPy's as well: a count has no decimals
        return int(value)
    if isinstance(value, Iterable):
        return [_plain(item) for item in value]
    return float(f"{float(value):.6g}")


def merge(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return one diagnostic for those that differ in their frames alone, in the order of the first; its values stay."""
    kept: dict[str, Diagnostic] = {}
    for item in found:
        key = repr((item.code, item.severity, item.remedy, replace(item.where, frames=()), _names(item.values)))
        first = kept.setdefault(key, item)
        runs = tuple(sorted({*first.where.frames, *item.where.frames}))
        kept[key] = replace(first, where=replace(first.where, frames=runs))
    return tuple(kept.values())


def _names(values: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return the values that are no figures."""
    return sorted((key, str(value)) for key, value in values.items() if not isinstance(value, int | float))


def warnings_in(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return those that are more than notes."""
    return tuple(item for item in found if item.severity is not Severity.NOTE)


def notes_in(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return the notes."""
    return tuple(item for item in found if item.severity is Severity.NOTE)


def read_diagnostics(values: Any) -> tuple[Diagnostic, ...]:
    """Return the diagnostics of a file or an event, a list as ``Diagnostic.as_dict`` makes it; others are left out."""
    items = values if isinstance(values, list | tuple) else ()
    return tuple(found for item in items if isinstance(item, Mapping) and (found := _read(item)))


def _read(item: Mapping[str, Any]) -> Diagnostic | None:
    code = item.get("code")
    if not isinstance(code, str):
        return None
    severities = {level.value: level for level in Severity}
    severity = severities.get(str(item.get("severity")), Severity.WARNING)
    remedies = {remedy.value: remedy for remedy in Remedy}
    where, figures = item.get("where"), item.get("values")
    return Diagnostic(
        code, severity, _read_where(where if isinstance(where, Mapping) else {}),
        {str(key): _kept(value) for key, value in figures.items()} if isinstance(figures, Mapping) else {},
        remedies.get(str(item.get("remedy")), Remedy.REPORTED),
    )  # fmt: skip


def _kept(value: Any) -> Any:
    """Return a value of a file if it is a text, a finite number or a list of these, else its beginning as text."""
    if isinstance(value, str | bool) or (isinstance(value, int | float) and math.isfinite(value)):
        return value
    return [_kept(v) for v in value] if isinstance(value, list) else str(value)[:40]


def _read_where(values: Mapping[str, Any]) -> Where:
    names = {key: _texts(values.get(key)) for key in ("cameras", "markers", "joints")}
    file, person = (str(values.get(key) or "") for key in ("file", "person"))
    return Where(file, _runs(values.get("frames")), person=person, **names)


def _texts(value: Any) -> tuple[str, ...]:
    return tuple(item for item in value if isinstance(item, str)) if isinstance(value, list) else ()


def _runs(value: Any) -> Frames:
    runs = value if isinstance(value, list) else []
    pairs = [run for run in runs if isinstance(run, list) and len(run) == 2]
    return tuple((a, b) for a, b in pairs if type(a) is int and type(b) is int and a <= b)
