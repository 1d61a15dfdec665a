"""What is wrong with what comes: counted by kind, and named when a kind comes for the first time."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class NamedOnce:
    """Counts of what could not be used."""

    counts: dict[str, int] = field(default_factory=dict)
    """How often something was wrong with what came, by kind."""
    news: list[tuple[str, str]] = field(default_factory=list)
    """Kind and sentence of what was wrong for the first time; whoever reports it takes it out."""

    def name_once(self, kind: str, message: str) -> None:
        """Count something that is wrong; the first of its kind is news."""
        if kind not in self.counts:
            self.news.append((kind, message))
        self.counts[kind] = self.counts.get(kind, 0) + 1
