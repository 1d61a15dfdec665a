"""Count the rows of the published tables by verdict.

Reads the records of the other benchmarks (`dev.py bench NAME --update`) and writes
docs/explanation/published-tables.md.
"""

from __future__ import annotations

from supply.pages import write_page
from supply.published_page import REPRODUCED, VERDICTS, counts, rows
from tests.benchmarks.metric import Metric


def run() -> list[Metric]:
    """Write the page and count its rows."""
    write_page("explanation/published-tables.md")
    found = counts(rows())
    keys = {name: f"{name.replace(' ', '_')}_rows" for name in VERDICTS}
    return [
        Metric(key, found[name], "rows", "higher" if name == REPRODUCED else "lower", rel_tol=0.0)
        for name, key in keys.items()
    ]
