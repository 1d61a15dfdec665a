"""The version of the program, which results, records and workers carry."""

VERSION = "0.1.0"
"""Major, minor and patch (semver.org). The same in ``pyproject.toml`` and in the extension's manifest."""
