"""Represent diagnostics as values. Their texts are in ``diagnostics.json``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from functools import cache
from numbers import Integral
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

from .errors import JobInvalid, ResultRefused
from .plain_text import plain

Frames = tuple[tuple[int, int], ...]  # First and last frame (inclusive) of each frame range.
_TABLE = Path(__file__).with_name("diagnostics.json")
_RESULTS = "Solve results"
_AFTER_READING = ("Recording problems", "Imported motions", "Glove data", _RESULTS)
_LISTS = ("frames", "cameras", "markers", "joints")
LONGEST_LIST = 6
"""Largest number of names or frame ranges listed in a sentence. The rest are counted."""
MOST_DOUBTS = 3  # Largest number of reading warnings that a refusal repeats.


class Severity(StrEnum):
    """Severity of a diagnostic. The value is its name in files."""

    ERROR = "error"  # The input or the result is rejected.
    WARNING = "warning"  # The result may be wrong.
    NOTE = "note"  # An assumption, a measurement or a correction.


class Remedy(StrEnum):
    """Action that the program took after a diagnostic. The value is its name in files."""

    REPORTED = "reported"  # Nothing was changed.
    REPAIRED = "repaired"  # The detections, labels or cameras were corrected.
    EXCLUDED = "excluded"  # The data were not used at this place.
    BRIDGED = "bridged"  # The motion was interpolated.


_DONE = {
    "repaired": ". This has been corrected",
    "excluded": ". These data are not used",
    "bridged": ". Gaps are interpolated",
}


@dataclass(frozen=True)
class DiagnosticEntry:
    """One row of the diagnostics table."""

    group: str  # Heading on the reference page.
    severity: Severity  # Default severity.
    text: str  # Sentence without full stop, with parameters in braces.
    cause: str = ""  # The usual cause, or empty if the text states it.
    remedy: str = ""  # Advice, or empty if nothing needs to be done.
    role: str = ""  # Role in camera faults: "explains", "unknown", "doubts", "compares" or "compares all".
    words: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """Texts that replace parameter values, by parameter and value. They may contain parameters."""


@cache
def load_table() -> dict[str, DiagnosticEntry]:
    """Return the entries of the diagnostics table by code."""
    import json  # not yet imported when Blender registers add-ons

    groups = json.loads(_TABLE.read_text(encoding="utf-8"))
    return {
        code: DiagnosticEntry(group, severity=Severity(row.pop("severity")), **row)
        for group, rows in groups.items()
        for code, row in rows.items()
    }


@cache
def list_refusals() -> tuple[str, ...]:
    """Return the codes of the errors that cause a solve to reject its result as unusable."""
    return tuple(c for c, row in load_table().items() if row.group == _RESULTS and row.severity is Severity.ERROR)


def is_of_reading(code: str) -> bool:
    """Return whether a diagnostic with this code is raised before the solve."""
    return (entry := load_table().get(code)) is not None and entry.group not in _AFTER_READING


@dataclass(frozen=True)
class Where:
    """File, frames and names that a diagnostic refers to. Fields that do not apply are empty."""

    file: str = ""
    frames: Frames = ()  # Frame ranges.
    cameras: tuple[str, ...] = ()  # Camera names. If others are listed for comparison, the faulty one is first.
    markers: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    person: str = ""

    def as_dict(self) -> dict[str, object]:
        """Return the non-empty fields as plain JSON values."""
        found = {item.name: getattr(self, item.name) for item in fields(self)} | {"frames": map(list, self.frames)}
        plain = {key: value if isinstance(value, str) else list(value) for key, value in found.items()}
        return {key: value for key, value in plain.items() if value}


class DiagnosticValues(TypedDict):
    """A diagnostic as plain JSON values."""

    code: str
    severity: str
    where: dict[str, object]
    values: dict[str, object]
    remedy: str


@dataclass(frozen=True)
class Diagnostic:
    """A statement about a capture or result, with a code and a severity."""

    code: str  # Key in the table. Files written by other versions may contain unknown codes.
    severity: Severity
    where: Where = Where()
    values: Mapping[str, Any] = field(default_factory=dict)  # Parameters for the table's texts, as plain JSON values.
    remedy: Remedy = Remedy.REPORTED

    def as_dict(self) -> DiagnosticValues:
        """Return plain JSON values that ``read_diagnostics`` can read."""
        where, severity, remedy = self.where.as_dict(), self.severity.value, self.remedy.value
        return {"code": self.code, "severity": severity, "where": where, "values": dict(self.values), "remedy": remedy}


class Words(NamedTuple):
    """Message and advice of a diagnostic."""

    what: str
    advice: str  # What to do, or empty if nothing.


# fmt: off
def diagnostic(
    code: str, *, severity: Severity | None = None, remedy: Remedy = Remedy.REPORTED, file: str = "",
    frames: Iterable[tuple[int, int]] = (), cameras: Sequence[str] = (), markers: Sequence[str] = (),
    joints: Sequence[str] = (), person: str = "", **values: Any,
) -> Diagnostic:
    # fmt: on
    """Create a diagnostic from its code in the table.

    Args:
        severity: None uses the severity in the table.
        file, frames, cameras, markers, joints, person: see ``Where``.
        values: parameters for the table's texts, rounded to six digits.
    """
    runs = tuple((int(a), int(b)) for a, b in frames)
    where = Where(file, runs, tuple(cameras), tuple(markers), tuple(joints), person)
    found = {key: _plain(value) for key, value in values.items()}
    return Diagnostic(code, severity or load_table()[code].severity, where, found, remedy)


def _plain(value: Any) -> Any:
    if isinstance(value, str | bool):
        return value
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Integral):  # including NumPy integers, because counts have no decimals
        return int(value)
    if isinstance(value, Iterable):
        return [_plain(item) for item in value]
    return float(f"{float(value):.6g}")


def merge(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Merge diagnostics that differ only in frames and figures. The figures of the first one are kept."""
    kept: dict[str, Diagnostic] = {}
    for item in found:
        names = sorted((key, str(value)) for key, value in item.values.items() if not isinstance(value, int | float))
        key = repr((item.code, item.severity, item.remedy, replace(item.where, frames=()), names))
        first = kept.setdefault(key, item)
        runs = tuple(sorted({*first.where.frames, *item.where.frames}))
        kept[key] = replace(first, where=replace(first.where, frames=runs))
    return tuple(kept.values())


def warnings_in(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return only the warnings and errors."""
    return tuple(item for item in found if item.severity is not Severity.NOTE)


def notes_in(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return only the notes."""
    return tuple(item for item in found if item.severity is Severity.NOTE)


def read_diagnostics(values: Any) -> tuple[Diagnostic, ...]:
    """Return the diagnostics in a file or event. Items in another format are skipped."""
    items = values if isinstance(values, list | tuple) else ()
    return tuple(_read(item) for item in items if isinstance(item, Mapping) and isinstance(item.get("code"), str))


def _read(item: Mapping[str, Any]) -> Diagnostic:
    where, values = (given if isinstance(given := item.get(key), Mapping) else {} for key in ("where", "values"))
    severity, remedy = item.get("severity"), item.get("remedy")
    return Diagnostic(
        item["code"],
        Severity(severity) if severity in list(Severity) else Severity.WARNING,
        _read_where(where),
        {str(key): _kept(value) for key, value in values.items()},
        Remedy(remedy) if remedy in list(Remedy) else Remedy.REPORTED,
    )


def _kept(value: Any) -> Any:
    """Limit a value to JSON types: text, finite numbers, lists and objects. Convert other values to short text."""
    if isinstance(value, str | bool) or (isinstance(value, int | float) and math.isfinite(value)):
        return value
    if isinstance(value, Mapping) and value:
        return {str(key)[:40]: _kept(item) for key, item in value.items()}
    return [_kept(v) for v in value] if isinstance(value, list) else str(value)[:40]


def _read_where(values: Mapping[str, Any]) -> Where:
    lists = {key: given if isinstance(given := values.get(key), list) else [] for key in _LISTS}
    pairs = [run for run in lists.pop("frames") if isinstance(run, list) and len(run) == 2]
    frames = tuple((a, b) for a, b in pairs if type(a) is int and type(b) is int and a <= b)
    names = {key: tuple(item for item in items if isinstance(item, str)) for key, items in lists.items()}
    return Where(str(values.get("file") or ""), frames, person=str(values.get("person") or ""), **names)


def word(found: Diagnostic, fps: float = 0.0) -> Words:
    """Return the message and advice of a diagnostic. For an unknown code, the message contains the code.

    Args:
        fps: frames per second, for the duration of frame ranges. 0 omits the duration.
    """
    where = f" in {frames_text(found.where.frames, fps)}" if found.where.frames else ""
    try:
        entry = load_table()[found.code]
        values = _fields(found, entry)
        what, advice = entry.text.format(**values), entry.remedy.format(**values)
    except (KeyError, ValueError, TypeError):  # the file was edited or written by another version
        return Words(plain(_stop(f"{_by_name(found)}{where}")), "")
    return Words(plain(_stop(f"{what}{where}{_DONE.get(found.remedy, '')}")), plain(advice))


def sentence(found: Diagnostic, fps: float = 0.0) -> str:
    """Return a diagnostic as one line with its message, location and remedy."""
    return " ".join(part for part in word(found, fps) if part)


def frames_text(runs: Sequence[tuple[int, int]], fps: float = 0.0) -> str:
    """Return frame ranges as text. The longest ranges are listed, and the other ranges are counted."""
    longest = sorted(sorted(runs, key=lambda run: run[0] - run[1])[:LONGEST_LIST])
    lengths = [f" ({(b - a + 1) / fps:.2f} s)" if fps > 0 else "" for a, b in longest]
    texts = [f"frame {a}" if a == b else f"frames {a}-{b}{s}" for (a, b), s in zip(longest, lengths, strict=True)]
    more = f" and {len(runs) - len(longest)} shorter ones" if len(runs) > len(longest) else ""
    return ", ".join(texts) + more


def listed(names: Iterable[str]) -> str:
    """Join the first names as text, followed by the number of remaining names."""
    names = list(names)
    more = f" and {len(names) - LONGEST_LIST} more" if len(names) > LONGEST_LIST else ""
    return (", ".join(names[:LONGEST_LIST]) or "none") + more


def _stop(text: str) -> str:
    return text if text.endswith((".", "?", "!")) else f"{text}."


def _fields(found: Diagnostic, entry: DiagnosticEntry) -> dict[str, Any]:
    where = found.where
    names: dict[str, Any] = {"file": where.file, "person": where.person}
    for one, several in (("camera", where.cameras), ("marker", where.markers), ("joint", where.joints)):
        names |= {f"{one}s": listed(several), one: several[0] if several else ""}
        names |= {f"other_{one}": several[1]} if len(several) > 1 else {}
    names |= {} if where.cameras else {"cameras": "all cameras"}
    values = names | {key: _listed_value(value) for key, value in found.values.items()}
    chosen = {name: words.get(str(values.get(name))) for name, words in entry.words.items()}
    return values | {name: text.format(**values) for name, text in chosen.items() if text is not None}


def _listed_value(value: Any) -> Any:
    if isinstance(value, Mapping):
        return listed(f"{key} {item}" for key, item in value.items())
    return listed(map(str, value)) if isinstance(value, list) else value


def _by_name(found: Diagnostic) -> str:
    where = [*found.where.cameras, *found.where.markers, *found.where.joints, found.where.person, found.where.file]
    parts = [name for name in where if name] + [f"{key} {value}" for key, value in found.values.items()]
    values = f" ({listed(parts)})" if parts else ""
    return f"Another version reported: {found.code.replace('_', ' ')}{values}"


def summarise(found: Sequence[Diagnostic], fps: float = 0.0) -> list[str]:
    """Return one line per warning, and a last line with "OK" or with the cameras, joints or frames to check.

    After a multi-view solve, the last line also states the stature, because images do not determine the world's scale.
    """
    warnings = warnings_in(found)
    lines = [f"{item.severity.value}: {sentence(item, fps)}" for item in warnings]
    last = f"Look at {_places(warnings)}." if warnings else "OK"
    return [*lines, f"{last.rstrip('.')}. {size}" if (size := size_in(found)) else last]


def size_in(found: Iterable[Diagnostic]) -> str:
    """Return the sentence about the person's solved stature, or "" if no diagnostic states it."""
    sizes = [item for item in found if item.code == "stature_solved"]
    return word(sizes[0]).what if sizes else ""


def _places(warnings: Sequence[Diagnostic]) -> str:
    parts = []
    for kind in ("cameras", "markers", "joints"):
        # A suspected swap names both cameras or markers, because either may be wrong.
        names = dict.fromkeys(name for item in warnings for name in getattr(item.where, kind))
        parts += [f"{kind[:-1] if len(names) == 1 else kind} {listed(names)}"] if names else []
    runs = _unite(run for item in warnings if not item.where.cameras for run in item.where.frames)
    parts += [frames_text(runs)] if runs else []
    if general := sum(not any(getattr(item.where, kind) for kind in _LISTS) for item in warnings):
        parts.append(f"the whole take ({general} warning{'' if general == 1 else 's'} above)")
    return "; ".join(parts)


def _unite(runs: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    united: list[tuple[int, int]] = []
    for first, last in sorted(runs):
        if united and first <= united[-1][1] + 1:
            united[-1] = united[-1][0], max(last, united[-1][1])
        else:
            united.append((first, last))
    return united


def check_accepted(codes: Iterable[str]) -> None:
    """Raise ``JobInvalid`` unless every code is in ``list_refusals``."""
    if unknown := [code for code in codes if code not in list_refusals()]:
        hint = f"Known codes: {', '.join(list_refusals())}."
        raise JobInvalid(f"There is no error to accept with the code {', '.join(unknown)}.", where="accept", hint=hint)


def refuse_errors(found: Iterable[Diagnostic], accepted: Iterable[str], where: str) -> tuple[Diagnostic, ...]:
    """Convert accepted errors to warnings, and raise ``ResultRefused`` if other errors remain.

    Args:
        accepted: codes from ``list_refusals``.

    Raises:
        ResultRefused: some errors are not accepted. The message lists these errors, and the hint contains their advice.
    """
    found, accepted = tuple(found), set(accepted)
    refused = [item for item in found if item.severity is Severity.ERROR and item.code not in accepted]
    if refused:
        words = [word(item) for item in refused]
        advices = dict.fromkeys(advice for _, advice in words)
        doubts = [word(i).what for i in found if is_of_reading(i.code) and i.severity is Severity.WARNING]
        reasons = [f"Earlier warnings may explain it: {' '.join(doubts[:MOST_DOUBTS])}"] if doubts else []
        options = " ".join(f"--accept {code}" for code in dict.fromkeys(item.code for item in refused))
        hint = " ".join([*reasons, *advices, f"To take the result anyway: {options}."])
        raise ResultRefused(" ".join(what for what, _ in words), where=where, hint=hint)
    return tuple(replace(i, severity=Severity.WARNING) if i.severity is Severity.ERROR else i for i in found)
