"""Words that the style of the project replaces, in all that a reader meets: messages, panels, help and documents."""

from __future__ import annotations

import re

WORDS = re.compile(
    r"\b(tells?|told|says?|said|(?<!too small to )judge[sd]?|errs?|whom|put right|put back"
    r"|takes? back|by the clock|the way between"
    r"|processor time|broke|anew|of no use|no use for|goes? with|is to be (?:a|an|the)|is to hold|are to lie)\b"
    r"|(?<!there )\b(?:is|are) (?:no|none of) (?!longer|more|less|better|worse|larger|smaller|heavier)|what is no "
    r"|can be\\.$",
    flags=re.IGNORECASE,
)
"""Left column of the style's table, and what else was met: the program reports, estimates, corrects; X is not a Y."""
