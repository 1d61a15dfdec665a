"""Hooks of the documents' site: links that leave ``docs`` become plain text, for what they name is not on the site."""

from __future__ import annotations

import os
import re
from typing import Any

_LINK = re.compile(r"\[([^\]]+)\]\((?![a-z]+:|#)([^)#\s]+)(#[^)]*)?\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Return a page's text with its links to files outside of the site as text alone.

    Args:
        markdown: the text.
        page: the page, whose ``file.src_uri`` is its path below ``docs``.
    """
    folder = os.path.dirname(page.file.src_uri)

    def keep(found: re.Match[str]) -> str:
        target = os.path.normpath(os.path.join(folder, found[2])).replace(os.sep, "/")
        return found[1] if target.startswith(("../", "examples/")) else found[0]

    return _LINK.sub(keep, markdown)
