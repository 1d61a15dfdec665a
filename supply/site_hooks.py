"""Hooks of the documents' site: links that leave ``docs`` become plain text; search lists records after guides."""

from __future__ import annotations

import os
import re
from typing import Any

RECORDS = ("research-log/", "decisions/")
"""Folders of what was tried and decided, which few readers look for."""
RECORDS_BOOST = 0.1
"""Their weight in the search, where other pages have 1; chosen by hand, so that a tutorial comes first."""
_LINK = re.compile(r"\[([^\]]+)\]\((?![a-z]+:|#)([^)#\s]+)(#[^)]*)?\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return a page's text with its links to files outside of the site as text alone; weigh the page for the search.

    Args:
        markdown: the text.
        page: the page, whose ``file.src_uri`` is its path below ``docs``.
    """
    if page.file.src_uri.startswith(RECORDS):
        page.meta["search"] = {"boost": RECORDS_BOOST}
    folder = os.path.dirname(page.file.src_uri)

    def keep(found: re.Match[str]) -> str:
        target = os.path.normpath(os.path.join(folder, found[2])).replace(os.sep, "/")
        return found[1] if target.startswith(("../", "examples/")) else found[0]

    return _LINK.sub(keep, markdown)
