"""The form of the documents: short pages, links whose anchors exist, every page three clicks from the README."""

from __future__ import annotations

import inspect
import re
from functools import cache
from pathlib import Path

import solver_backend
from tests.support.style_words import WORDS

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = sorted((ROOT / "docs").rglob("*.md"))
OF_THE_REPOSITORY = [ROOT / name for name in ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")]
TEMPLATES = sorted((ROOT / ".github").rglob("*.md"))
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))
GENERATED = {path for path in PAGES if path.read_text(encoding="utf-8").startswith("<!-- Made by")}
KEPT = {path for path in PAGES if path.parent.name in ("research-log", "decisions")}
"""Dated records, which may state what was tried."""
HISTORY = re.compile(r"\b(not kept|was tried|used to be)\b", flags=re.IGNORECASE)
"""Words that begin what belongs to the research log."""


MOST_FIGURES = 3
FIGURE = re.compile(r"(?<![\w.,/:-])\d+(?:[.,]\d+)*")
"""A number in prose; those of codes, links and names are none."""


def paragraphs(text: str) -> list[str]:
    """Return paragraphs and items of lists without code, targets of links, headings and tables."""
    text = re.sub(r"```.*?```|<!--.*?-->", "\n", text, flags=re.DOTALL)
    text = re.sub(r"`[^`]*`|\]\([^)]*\)", "", text)
    text = re.sub(r"^\s*(?:[-*]|\d+\.) ", "\n", text, flags=re.MULTILINE)
    return [part.strip() for part in re.split(r"\n\s*\n", text) if part.strip() and part.strip()[0] not in "#|"]


@cache
def anchors(page: Path) -> set[str]:
    heads = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def links(page: Path) -> list[tuple[Path, str]]:
    found = re.findall(r"\]\((?![a-z]+:)([^)#\s]*)(?:#([^)]*))?\)", page.read_text(encoding="utf-8"))
    return [((page.parent / target).resolve() if target else page, anchor) for target, anchor in found]


def test_a_how_to_begins_with_its_case() -> None:
    heads = {page: page.read_text(encoding="utf-8").splitlines()[:3] for page in PAGES if page.parent.name == "how-to"}
    assert len(heads) > 10
    for page, (title, empty, case) in heads.items():
        is_one = title.startswith("# ") and not empty and re.match(r"\*You[r ]", case)
        assert is_one, f"{page.name} begins as in *You have one video …*"


def test_the_readme_is_a_front_door() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 90


def test_a_page_is_read_in_one_sitting_and_its_tables_fit() -> None:
    lines = {page: page.read_text(encoding="utf-8").splitlines() for page in PAGES}
    assert not [page.name for page in PAGES if len(lines[page]) > 250 and page not in GENERATED]
    rows = [(page.name, line.replace("\\|", "")) for page in PAGES for line in lines[page] if line.startswith("|")]
    assert not [(name, row) for name, row in rows if row.count("|") > 8]


MOST_WORDS = 30  # Of a sentence; a piece of code counts as one.


def sentences(text: str) -> list[str]:
    """Return the sentences of paragraphs and items of lists, pieces of code as one word."""
    kept = re.sub(r"```.*?```", "\n\n", text, flags=re.DOTALL)
    parts = paragraphs(re.sub(r"`[^`]*`", "Code", kept))
    plain = (" ".join(whole.replace("*", "").split()) for whole in parts)
    return [part for whole in plain for part in re.split(r"(?<=[.!?])\s+(?=[A-Z\[])", whole)]


LOG = {path for path in KEPT if path.parent.name == "research-log"}
"""Tables and their remarks as they were measured: nobody needs to read them, and figures are what they hold."""
READ_THROUGH = sorted({README, ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", *PAGES} - LOG)


def test_a_sentence_is_read_in_one_breath() -> None:
    parts = [(page.name, part) for page in READ_THROUGH for part in sentences(page.read_text(encoding="utf-8"))]
    assert not [(name, part) for name, part in parts if len(part.split()) > MOST_WORDS]


def test_a_paragraph_has_three_figures_at_most() -> None:
    texts = [(page.name, text) for page in READ_THROUGH for text in paragraphs(page.read_text(encoding="utf-8"))]
    assert not [(name, text) for name, text in texts if len(FIGURE.findall(text)) > MOST_FIGURES], "a table holds more"


def test_figures_of_a_paragraph_are_counted() -> None:
    prose = "At 60 Hz it takes 7.5 s and 1,200 MB (`--fps 30`, [2 of 3](4.md))."
    [text] = paragraphs(f"# 9\n\n{prose}\n\n| 1 | 2 |\n```sh\nrun 1 2 3 4\n```\n")
    assert FIGURE.findall(text) == ["60", "7.5", "1,200", "2", "3"]
    assert len(paragraphs("1. one\n2. two\n\n- 3\n- 4")) == 4


def test_links_go_to_headings_that_are_there() -> None:
    found = [(page.name, target, anchor) for page in (README, *PAGES) for target, anchor in links(page) if anchor]
    assert not [(name, target.name, anchor) for name, target, anchor in found if anchor not in anchors(target)]


def test_every_page_is_within_three_clicks_of_the_readme() -> None:
    reached, edge = {README}, {README}
    for _ in range(3):
        edge = {
            target for page in edge for target, _ in links(page) if target.suffix == ".md" and target.exists()
        } - reached
        reached |= edge
    assert not [path.name for path in PAGES if path not in reached]


WRITTEN = [README, *OF_THE_REPOSITORY, *PAGES, *TEMPLATES, ROOT / "solver_backend" / "report" / "page.js"]


def prose_of(page: Path) -> str:
    """Return a page's text without code and targets of links."""
    return re.sub(r"```.*?```|`[^`]*`|\]\([^)]*\)", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_a_page_speaks_as_a_colleague_would() -> None:
    texts = {page: prose_of(page) for page in WRITTEN}
    found = [(page.name, text, match) for page, text in texts.items() for match in WORDS.finditer(text)]
    assert not [(name, text[max(match.start() - 30, 0) : match.end() + 20]) for name, text, match in found]
    assert not [page.name for page, text in texts.items() if page not in KEPT and HISTORY.search(text)]


def test_an_example_speaks_as_a_colleague_would() -> None:
    assert not [(path.name, found) for path in EXAMPLES if (found := WORDS.findall(path.read_text(encoding="utf-8")))]


def test_the_documentation_of_the_python_api_speaks_so_too() -> None:
    for name in solver_backend.__all__:
        public = getattr(solver_backend, name)
        members = [public, *(vars(public).values() if isinstance(public, type) else ())]
        text = "\n".join(inspect.getdoc(member) or "" for member in members if hasattr(member, "__doc__"))
        assert not WORDS.findall(text), name


def test_the_citation_names_the_methods() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    references = text.partition("\nreferences:\n")[2]
    assert references.count("- type:") == references.count("year: ") >= 6
    assert references.count("doi: 10.") >= 5
    assert all(name in references for name in ("Albanis", "Tiwari", "Loper"))
