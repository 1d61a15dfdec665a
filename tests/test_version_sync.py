"""One version everywhere it stands."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import solver_backend

ROOT = Path(__file__).resolve().parents[1]


def test_package_project_manifest_and_changelog_say_the_same_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    manifest = tomllib.loads((ROOT / "blender_addon" / "blender_manifest.toml").read_text(encoding="utf-8"))["version"]
    heading = re.search(r"^## \[(\d[^\]]*)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert heading is not None
    assert {solver_backend.__version__, project, manifest, heading.group(1)} == {project}
