"""Convert links to files outside the documentation site to plain text (a hook of MkDocs)."""

from __future__ import annotations

import os
import re
from typing import Any

OUTSIDE = (
    "../",
    "examples/",
    "decisions/",
    "research-log/",
    "explanation/published-tables.md",
    "explanation/formulas.md",
    "explanation/architecture.md",
    "how-to/extend.md",
    "explanation/complaints.md",
    "explanation/threat-model.md",
)
"""Paths outside the site: the repository outside ``docs``, and records for developers (see mkdocs.yml)."""
_LINK = re.compile(r"\[([^\]]+)\]\((?![a-z]+:|#)([^)#\s]+)(#[^)]*)?\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Replace links to files outside the site with their text.

    Args:
        markdown: text of the page.
        page: the page, with ``file.src_uri`` as its path below ``docs``.
    """
    folder = os.path.dirname(page.file.src_uri)

    def keep(found: re.Match[str]) -> str:
        target = os.path.normpath(os.path.join(folder, found[2])).replace(os.sep, "/")
        return found[1] if target.startswith(OUTSIDE) else found[0]

    return _LINK.sub(keep, markdown)
