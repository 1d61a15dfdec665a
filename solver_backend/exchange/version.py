"""State the program version, which is written to results, records and workers."""

VERSION = "0.1.0"
"""Major, minor and patch (semver.org), as in ``pyproject.toml`` and the extension's manifest."""
