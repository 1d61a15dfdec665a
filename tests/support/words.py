"""Sentences of what was found, for tests that look for words."""

from __future__ import annotations

from collections.abc import Iterable

from solver_backend.exchange.diagnostics import Diagnostic, sentence, word


def words(found: Iterable[Diagnostic | str]) -> tuple[str, ...]:
    """Return what was found in words."""
    return tuple(item if isinstance(item, str) else sentence(item) for item in found)


def facts(found: Iterable[Diagnostic]) -> tuple[str, ...]:
    """Return what was found in words, without what to do."""
    return tuple(word(item).what for item in found)


def codes(found: Iterable[Diagnostic]) -> tuple[str, ...]:
    """Return the codes of what was found."""
    return tuple(item.code for item in found)
