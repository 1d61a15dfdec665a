"""Stand-in files, without a Blender."""

from __future__ import annotations

import pytest

from tests.support.addon_stand_in import Files, write_files


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """Write a body, a motion and a capture once."""
    return write_files(tmp_path_factory.mktemp("stand in ü"))
