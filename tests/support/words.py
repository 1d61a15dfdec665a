"""Sentences of what was found, for tests that look for words."""

from __future__ import annotations

from collections.abc import Iterable

from solver_backend.exchange.diagnostics import Diagnostic, sentence


def words(found: Iterable[Diagnostic | str]) -> tuple[str, ...]:
    """Return what was found in words."""
    return tuple(item if isinstance(item, str) else sentence(item) for item in found)
