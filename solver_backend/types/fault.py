"""What was found wrong with a recording, and what was done about it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any


class FaultKind(StrEnum):
    """What can be wrong with a view; the value is the name written to files."""

    LIMBS_EXCHANGED = "limbs_exchanged"
    """The detector took left for right limbs for a while."""


class Remedy(StrEnum):
    """What was done about a fault."""

    REPAIRED = "repaired"
    """The detections or the camera were put right."""
    EXCLUDED = "excluded"
    """The view's detections were not used in these frames."""
    REPORTED = "reported"
    """Nothing was changed."""


@dataclass(frozen=True)
class Fault:
    """One fault of one view over a stretch of frames."""

    kind: FaultKind
    """What is wrong."""
    camera: str
    """Name of the camera."""
    first: int
    """First frame."""
    last: int
    """Last frame."""
    figure: float
    """The evidence; the unit goes with the kind."""
    remedy: Remedy
    """What was done."""
    detail: str = ""
    """Which part of the view, where that matters."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {**asdict(self), "kind": self.kind.value, "remedy": self.remedy.value}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Fault:
        """Return a fault from plain values, as ``as_dict`` gives them."""
        return cls(**{**values, "kind": FaultKind(values["kind"]), "remedy": Remedy(values["remedy"])})
