"""The kinds of work that a worker can be handed, by the name that travels with them."""

from __future__ import annotations

from .shots import Shots
from .takes import Takes
from .work import Plain, Work

_KINDS: dict[str, type[Takes] | type[Shots]] = {kind.kind: kind for kind in (Takes, Shots)}


def work_of(values: Plain) -> Work:
    """Return the work that its ``plain`` has written."""
    return _KINDS[values["kind"]].from_plain(values)
