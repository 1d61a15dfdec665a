"""Define the program version, which results, records and workers contain."""

VERSION = "0.1.0"
"""Major, minor and patch (semver.org), as in ``pyproject.toml`` and the extension's manifest."""
