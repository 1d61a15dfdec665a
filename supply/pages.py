"""Write all generated documentation pages: ``python3 dev.py docs``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.verbs import GROUPS
from supply.command_line_page import command_line_page, group_page
from supply.diagnostics_page import GROUPS as DIAGNOSTICS
from supply.diagnostics_page import diagnostics_group, diagnostics_page, errors_page
from supply.job_file_page import job_file_page
from supply.joint_sets_page import joint_sets_page
from supply.method_diagrams import DIAGRAMS
from supply.published_page import published_page
from supply.python_api_page import python_api_page
from supply.results_page import CHARTS, draw_chart, results_page
from supply.settings_page import settings_page

FOLDER = Path(__file__).resolve().parents[1] / "docs"
PAGES: dict[str, Callable[[], str]] = {
    "explanation/published-tables.md": published_page,
    "reference/command-line.md": command_line_page,
    **{f"reference/command-line-{group}.md": partial(group_page, group) for group in GROUPS},
    "reference/diagnostics.md": diagnostics_page,
    **{f"reference/diagnostics-{page}.md": partial(diagnostics_group, page) for page in DIAGNOSTICS},
    "reference/errors.md": errors_page,
    "reference/job-file.md": job_file_page,
    "reference/joint-sets.md": joint_sets_page,
    "reference/python-api.md": python_api_page,
    "reference/settings.md": settings_page,
    "results.md": results_page,
    **{f"images/results_{chart.name}.svg": partial(draw_chart, chart) for chart in CHARTS},
    **{f"images/method_{name}.svg": draw for name, draw in DIAGRAMS.items()},
}
"""Function that returns each page, by its path below docs."""


def main() -> int:
    """Write all pages, and return the exit code."""
    for name in PAGES:
        sys.stdout.write(f"{write_page(name)}\n")
    return 0


def write_page(name: str, folder: Path = FOLDER) -> Path:
    """Write one page, given its path below the folder, and return the file's path."""
    return write_text(folder / name, PAGES[name](), overwrite=True)


if __name__ == "__main__":
    raise SystemExit(main())
