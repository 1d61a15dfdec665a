"""Diagnostics in words: the one place where sentences are made of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from ..plain_text import plain
from .diagnostic import Diagnostic, Remedy
from .table import TABLE

LONGEST_LIST = 6
"""Names or stretches of frames that are named one by one; the rest is counted."""

_DONE = {
    Remedy.REPORTED: "",
    Remedy.REPAIRED: ": corrected",
    Remedy.EXCLUDED: ": not used there",
    Remedy.BRIDGED: ": bridged",
}


class Words(NamedTuple):
    """A diagnostic for people."""

    what: str
    """One sentence: what was found, and where."""
    advice: str
    """One sentence: what to do; empty where nothing is to be done."""


def word(found: Diagnostic, fps: float = 0.0) -> Words:
    """Return a diagnostic in words; a code that the table lacks is shown by name.

    Args:
        found: of any origin.
        fps: frames a second, to state how long stretches are; 0 leaves that out.
    """
    entry = TABLE.get(found.code)
    if entry is None:
        return Words(plain(_stopped(_by_name(found, fps))), "")
    fields = _fields(found)
    try:
        what, advice = entry.what.format(**fields), entry.advice.format(**fields)
    except (KeyError, ValueError, TypeError):  # a file of another version, or one that was edited
        return Words(plain(_stopped(_by_name(found, fps))), "")
    where = f" in {frames_text(found.where.frames, fps)}" if found.where.frames else ""
    return Words(plain(_stopped(f"{what}{where}{_DONE[found.remedy]}")), plain(advice))


def sentence(found: Diagnostic, fps: float = 0.0) -> str:
    """Return a diagnostic on one line: what was found, where, and what to do."""
    return " ".join(part for part in word(found, fps) if part)


def frames_text(runs: Sequence[tuple[int, int]], fps: float = 0.0) -> str:
    """Return stretches of frames as text, the longest ones by name."""
    longest = sorted(sorted(runs, key=lambda run: run[0] - run[1])[:LONGEST_LIST])
    named = [f"frame {a}" if a == b else f"frames {a}-{b}{_seconds(b - a + 1, fps)}" for a, b in longest]
    more = f" and {len(runs) - len(longest)} shorter ones" if len(runs) > len(longest) else ""
    return ", ".join(named) + more


def listed(names: Iterable[str]) -> str:
    """Return the first names as text, and how many more there are."""
    names = list(names)
    more = f" and {len(names) - LONGEST_LIST} more" if len(names) > LONGEST_LIST else ""
    return (", ".join(names[:LONGEST_LIST]) or "none") + more


def _seconds(frames: int, fps: float) -> str:
    return f" ({frames / fps:.2f} s)" if fps > 0 else ""


def _stopped(text: str) -> str:
    return text if text.endswith((".", "?", "!")) else f"{text}."


def _fields(found: Diagnostic) -> dict[str, Any]:
    """Return what a sentence of the table can name."""
    where = found.where
    names: dict[str, Any] = {"file": where.file, "person": where.person}
    for one, several in (("camera", where.cameras), ("marker", where.markers), ("joint", where.joints)):
        names |= {f"{one}s": listed(several), one: several[0] if several else ""}
        names |= {f"other_{one}": several[1]} if len(several) > 1 else {}
    values = {k: listed(map(str, v)) if isinstance(v, list) else v for k, v in found.values.items()}
    return {**names, **values}


def _by_name(found: Diagnostic, fps: float) -> str:
    """Return a diagnostic by its code, with what it concerns and its values."""
    where = [*found.where.cameras, *found.where.markers, *found.where.joints, found.where.person, found.where.file]
    parts = [name for name in where if name] + [f"{key} {value}" for key, value in found.values.items()]
    frames = f" in {frames_text(found.where.frames, fps)}" if found.where.frames else ""
    return f"{found.code}{f' ({listed(parts)})' if parts else ''}{frames}"
