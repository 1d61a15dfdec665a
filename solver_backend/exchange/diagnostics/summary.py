"""The end of a solve for a person in a hurry: every warning on a line, and a last line to trust."""

from __future__ import annotations

from collections.abc import Sequence

from .diagnostic import Diagnostic, warnings_in
from .wording import frames_text, listed, sentence


def summarise(found: Sequence[Diagnostic], fps: float = 0.0) -> list[str]:
    """Return a line for each warning, and a last one: "OK", or "Look at" the cameras, markers, joints and frames.

    Args:
        found: everything that was found.
        fps: frames a second, 0 if unknown.
    """
    warnings = warnings_in(found)
    lines = [f"{item.severity.value}: {sentence(item, fps)}" for item in warnings]
    return [*lines, f"Look at {_places(warnings)}." if warnings else "OK"]


def _places(warnings: Sequence[Diagnostic]) -> str:
    """Return what the warnings concern, most of all frames, in a few words."""
    parts = []
    for kind in ("cameras", "markers", "joints"):
        # An exchange names two cameras or markers; both want a look.
        names = dict.fromkeys(name for item in warnings for name in getattr(item.where, kind))
        parts += [f"{kind[:-1] if len(names) == 1 else kind} {listed(names)}"] if names else []
    runs = _united(run for item in warnings if not item.where.cameras for run in item.where.frames)
    parts += [frames_text(runs)] if runs else []
    general = sum(not (w.where.cameras or w.where.markers or w.where.joints or w.where.frames) for w in warnings)
    count = "1 warning" if general == 1 else f"{general} warnings"
    return "; ".join([*parts, *([f"the whole take ({count} above)"] if general else [])])


def _united(runs: object) -> list[tuple[int, int]]:
    """Return stretches of frames without overlaps, in their order."""
    united: list[tuple[int, int]] = []
    for first, last in sorted(runs):  # type: ignore[call-overload]
        if united and first <= united[-1][1] + 1:
            united[-1] = united[-1][0], max(last, united[-1][1])
        else:
            united.append((first, last))
    return united
