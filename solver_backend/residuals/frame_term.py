"""What every term of a frame's objective offers, whatever it evaluates: some of its frames, and another precision."""

from __future__ import annotations

from typing import Any, Protocol, Self


class FrameTerm(Protocol):
    """A term of F frames."""

    def select(self, frames: Any) -> Self:
        """Return the term of the frames at these indices (or of this slice)."""
        ...

    def astype(self, precision: Any) -> Self:
        """Return the term with its arrays in a precision of their own kind."""
        ...
