"""Jobs in the pages have only settings that have an effect: a strict solve refuses the others."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from solver_backend.exchange.solve_settings import SolveSettings

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = re.compile(r'"settings": (\{[^{}]*\})')
JOBS = [
    (page.name, given)
    for page in sorted((ROOT / "docs").rglob("*.md"))
    for given in SETTINGS.findall(page.read_text(encoding="utf-8"))
    if "CODE" not in given and "research-log" not in page.parts
]


def test_pages_hold_jobs() -> None:
    assert {"job-file.md", "batch-and-cluster.md"} <= {page for page, _ in JOBS}


@pytest.mark.parametrize(("page", "given"), JOBS)
def test_each_setting_of_a_job_has_an_effect(page: str, given: str) -> None:
    assert not SolveSettings.from_dict(json.loads(given)).without_effect, page
