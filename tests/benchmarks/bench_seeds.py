"""How many rows of the published tables are reproduced, contradicted, and not measured, by the committed baselines.

Reads what the other benchmarks recorded (`dev.py bench NAME --update`) and writes docs/explanation/published-tables.md.
"""

from __future__ import annotations

from supply.pages import write_page
from supply.published_page import CONTRADICTED, NOT_MEASURED, REPRODUCED, counts, rows
from tests.benchmarks.metric import Metric


def run() -> list[Metric]:
    """Write the page and count its rows."""
    write_page("explanation/published-tables.md")
    found = counts(rows())
    return [
        Metric("reproduced_rows", found[REPRODUCED], "rows", "higher", rel_tol=0.0),
        Metric("contradicted_rows", found[CONTRADICTED], "rows", rel_tol=0.0),
        Metric("not_measured_rows", found[NOT_MEASURED], "rows", rel_tol=0.0),
    ]
