"""Blender as a type checker sees it: anything. Its module carries no types."""

from typing import Any

def __getattr__(name: str) -> Any: ...
