"""Results that are surely useless: refused, unless the user accepts the fault by its code."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from ..errors import JobInvalid, ResultRefused
from .diagnostic import Diagnostic
from .entry import Severity
from .result import RESULT
from .table import READING
from .wording import word

REFUSALS = tuple(code for code, entry in RESULT.items() if entry.severity is Severity.ERROR)
"""Codes for which a result is refused."""

MOST_DOUBTS = 3
"""Doubts of the reader that a refusal repeats."""


def check_accepted(codes: Iterable[str]) -> None:
    """Check that results are refused for these codes.

    Raises:
        JobInvalid: one is no such code; the message lists those there are.
    """
    unknown = [code for code in codes if code not in REFUSALS]
    if unknown:
        raise JobInvalid(
            f"No result is refused for {', '.join(unknown)}.", where="accept", hint=f"Codes are {', '.join(REFUSALS)}."
        )


def refuse_errors(found: Iterable[Diagnostic], accepted: Iterable[str], where: str) -> tuple[Diagnostic, ...]:
    """Return what was found, accepted errors as warnings.

    Args:
        found: everything that was found about a result.
        accepted: codes of ``REFUSALS``.
        where: the capture, for the message.

    Raises:
        ResultRefused: an error is not accepted; the message has every one, the hint what to do.
    """
    found, accepted = tuple(found), {_fault(code) for code in accepted}
    refused = [item for item in found if item.severity is Severity.ERROR and _fault(item.code) not in accepted]
    if refused:
        words = [word(item) for item in refused]
        advices = dict.fromkeys(advice for _, advice in words)
        doubts = [word(item).what for item in found if item.code in READING and item.severity is Severity.WARNING]
        reasons = [f"What was found before may explain it: {' '.join(doubts[:MOST_DOUBTS])}"] if doubts else []
        options = " ".join(f"--accept {code}" for code in dict.fromkeys(_fault(item.code) for item in refused))
        raise ResultRefused(
            " ".join(what for what, _ in words), where=where,
            hint=" ".join([*reasons, *advices, f"To take the result even so: {options}."]),
        )  # fmt: skip
    return tuple(replace(i, severity=Severity.WARNING) if i.severity is Severity.ERROR else i for i in found)


def _fault(code: str) -> str:
    """Return the fault of a code: of views and of markers it is the same one, with another remedy."""
    return code.removesuffix("_markers")
