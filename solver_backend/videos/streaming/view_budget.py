"""How many views a moment has: all, if the machine detects them in time; views are left out before moments are."""

from __future__ import annotations

FEWEST = 2
"""Views without which nothing is triangulated."""
_NEW = 0.2
"""Share of a moment in the usual time of one."""
_EASY = 0.8
"""Another view is added where the moment would take less than this share of the interval."""


class ViewBudget:
    """The number of views that are detected at a time."""

    def __init__(self, views: int, interval_s: float) -> None:
        """Begin with all.

        Args:
            views: C.
            interval_s: seconds from a moment to the next that are wanted.
        """
        self.most, self.interval_s, self.count = views, interval_s, views
        self._usual_s: float | None = None

    def took(self, count: int, seconds: float) -> None:
        """Learn how long a moment of so many views took; what was begun under another number teaches nothing."""
        if count != self.count:
            return
        before = self._usual_s
        self._usual_s = seconds if before is None else before + _NEW * (seconds - before)
        if self._usual_s > self.interval_s and count > FEWEST:
            self._set(count - 1)
        elif count < self.most and self._usual_s * (count + 1) / count < _EASY * self.interval_s:
            self._set(count + 1)

    def _set(self, count: int) -> None:
        """Take another number; processors are shared, so that a moment's time goes with it."""
        assert self._usual_s is not None
        self._usual_s *= count / self.count
        self.count = count
