"""The faults of a recording in sentences, each with what to do about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from solver_backend.types import Fault, FaultKind, Motion, Remedy

LONGEST_LIST = 6
"""Stretches of frames named one by one; the rest is counted."""

_DONE = {
    Remedy.REPAIRED: "put right",
    Remedy.EXCLUDED: "the view is not used there",
    Remedy.REPORTED: "nothing was changed",
}


@dataclass(frozen=True)
class FaultText:
    """One sentence about faults of one kind in one camera."""

    what: str
    advice: str
    bad: bool
    """The solve suffers; otherwise it was put right."""


def faults_of(motion: Motion) -> list[Fault]:
    """Return the faults that a solve wrote down."""
    return [Fault.from_dict(values) for values in motion.provenance.get("findings", ())]


def fault_texts(faults: Sequence[Fault], fps: float) -> list[FaultText]:
    """Return a sentence for each camera and kind of fault, in the order of their first frames."""
    groups: dict[tuple[FaultKind, str, str, Remedy], list[Fault]] = {}
    for fault in faults:
        groups.setdefault((fault.kind, fault.camera, fault.detail, fault.remedy), []).append(fault)
    return [_text(group, fps) for group in groups.values()]


def frames_text(runs: Sequence[tuple[int, int]], fps: float) -> str:
    """Return stretches of frames as text, the longest ones by name."""
    longest = sorted(sorted(runs, key=lambda run: run[0] - run[1])[:LONGEST_LIST])
    named = [f"frame {a}" if a == b else f"frames {a}-{b} ({(b - a + 1) / fps:.2f} s)" for a, b in longest]
    more = f" and {len(runs) - len(longest)} shorter ones" if len(runs) > len(longest) else ""
    return ", ".join(named) + more


def _text(group: list[Fault], fps: float) -> FaultText:
    fault = group[0]
    where = frames_text([(f.first, f.last) for f in group], fps)
    what, advice = _WORDS[fault.kind](fault)
    return FaultText(f"{what} in {where}: {_DONE[fault.remedy]}.", advice, fault.remedy is not Remedy.REPAIRED)


def _limbs_exchanged(fault: Fault) -> tuple[str, str]:
    return (
        f"Camera {fault.camera}: left and right {fault.detail} are exchanged",
        "Nothing to do; compare with the footage if the limbs look wrong there.",
    )


_WORDS: dict[FaultKind, Callable[[Fault], tuple[str, str]]] = {FaultKind.LIMBS_EXCHANGED: _limbs_exchanged}
