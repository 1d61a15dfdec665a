"""The site of the documents is built strictly: no broken link, no page outside the navigation, no network."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from supply.site_hooks import OUTSIDE

ROOT = Path(__file__).resolve().parents[2]
MOST_WORDS = 44_600
"""Of all pages of the site, by ``count_words``. The goal is 45,000, so lower this number when text goes."""


def count_words(text: str) -> int:
    """Count a page's words and pieces of inline code without code blocks, table markup and targets of links."""
    text = re.sub(r"```.*?```|<!--.*?-->|\]\([^)]*\)", " ", text, flags=re.DOTALL).replace("|", " ")
    return sum(1 for word in text.split() if re.search(r"\w", word))


def test_the_site_stays_short() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    pages = re.findall(r"[\w/-]+\.md", navigation)
    words = {page: count_words((ROOT / "docs" / page).read_text(encoding="utf-8")) for page in pages}
    assert len(words) > 60
    assert sum(words.values()) <= MOST_WORDS, words


def test_words_of_a_page_are_counted_without_markup() -> None:
    assert count_words("# Two words\n\n| `a b` | [link](to/page.md) |\n|---|---|\n```sh\nrun it\n```\n") == 5


def build(config: Path, out: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(config), "-d", str(out)]
    nowhere = dict.fromkeys(("http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY"), "http://127.0.0.1:9")
    env = {**os.environ, **nowhere, "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, capture_output=True, text=True, env=env, cwd=ROOT)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    done = build(ROOT / "mkdocs.yml", tmp_path / "site")
    assert done.returncode == 0, done.stderr
    assert "solver_backend.fitters.pipeline.solve" in (tmp_path / "site" / "reference" / "python-api.html").read_text(
        encoding="utf-8"
    )
    index = (tmp_path / "site" / "search" / "search_index.js").read_text(encoding="utf-8")
    found = json.loads(index[index.index("{") : index.rindex("}") + 1])["docs"]
    assert any(entry["location"].startswith("tutorials/") for entry in found)
    left_out = tuple(name.removesuffix(".md") for name in OUTSIDE)
    assert not [entry["location"] for entry in found if entry["location"].startswith(left_out)]


def test_a_broken_link_breaks_the_build(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("[away](nowhere.md)", encoding="utf-8")
    config = tmp_path / "mkdocs.yml"
    config.write_text("site_name: x\nstrict: true\nvalidation: {links: {not_found: warn}}\n", encoding="utf-8")
    assert build(config, tmp_path / "site").returncode != 0
