"""Generate the reference page of all solve settings and reading options."""

from __future__ import annotations

from solver_backend.exchange.reading_settings import ROWS as READING_ROWS
from solver_backend.exchange.setting import Setting, settings_of_class
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.verb import describe_default, describe_range

SOURCE = "solver_backend/exchange/solve_settings.py, and reading_settings.py"
_HEAD = """# Solve settings

If you are unsure, keep the defaults. Each setting is an option of `solve` and `from-videos`, a key under `settings` in
a [job file](job-file.md), and a control in Blender's *Solve* panel. The key `foot_lock` is the option `--foot-lock`.
The prefix `no-` turns an on/off setting off, as in `--no-contacts`."""
_OF_READING = """Every command that reads a capture has these options and `--sync`. In a job file, they are keys next to
`settings`. In Blender, they are under *Reading Options*."""


def settings_page() -> str:
    """Return the reference page of all solve settings and reading options."""
    parts = [f"<!-- Made by python3 dev.py docs from {SOURCE}; edit that. -->", "", _HEAD]
    rows = settings_of_class(SolveSettings) | READING_ROWS
    for title in dict.fromkeys(row.group for row in rows.values()):
        listed = [(name, row) for name, row in rows.items() if row.group == title]
        parts += ["", f"## {title}", "", *([_OF_READING, ""] if listed[0][0] == next(iter(READING_ROWS)) else [])]
        parts += ["| key | panel | values | default | meaning |", "|---|---|---|---|---|"]
        parts += [_row(name, row) for name, row in listed]
        choices = [(row, choice) for _, row in listed for choice in row.choices]
        if choices:
            parts += ["", *(f"- {row.label} `{c.value}` (*{c.label}*): {c.description}." for row, c in choices)]
    return "\n".join([*parts, ""])


def _row(name: str, row: Setting) -> str:
    if row.options[0] != f"--{name.replace('_', '-')}":
        raise ValueError(f"The page derives the option of {name} from its key, but it is {row.options[0]}.")
    panel = row.control or f"*{row.label}*"
    values = describe_range(row) or row.metavar or "on, off"
    alone = f" Only used by {' and '.join(f'`{name}`' for name in row.methods)}." if row.methods else ""
    cells = (f"`{name}`", panel, values, describe_default(row) or "–", f"{row.description}.{alone}")
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
