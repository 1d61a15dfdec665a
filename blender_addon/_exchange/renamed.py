"""Options, keys and verbs that have another name today: the earlier one works until the next release, with a note."""

from __future__ import annotations

import argparse
import sys
from typing import Any


class RenamedOption(argparse.Action):
    """Stores a value, with a note on standard error where the option has an earlier name; its first name is today's."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Store the value."""
        setattr(namespace, self.dest, values)
        if option in self.option_strings[1:]:
            note_renamed(str(option), self.option_strings[0])


def note_renamed(earlier: str, today: str) -> None:
    """Note on standard error that an option, a key or a verb has another name today."""
    sys.stderr.write(f"note: {earlier} is now called {today}; the next release knows {today} alone.\n")
