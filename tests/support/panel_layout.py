"""A panel's layout without a window: it takes down what is drawn."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any


class Layout:
    """Takes down what a panel draws."""

    def __init__(self) -> None:
        self.drawn: list[str] = []

    def __getattr__(self, name: str) -> Any:
        def draw(*args: Any, **given: Any) -> Any:
            if name in ("row", "column", "box", "split", "grid_flow"):
                return self
            said = given.get("text", "") if name != "prop" else f"{type(args[0]).__name__}.{args[1]}"
            self.drawn.append(f"{name}:{said}")
            return SimpleNamespace()

        return draw

    def __setattr__(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)
