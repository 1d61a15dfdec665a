"""Asking a Python what it has."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy
import pytest

import solver_backend
from blender_addon._exchange.errors import BackendMissing
from blender_addon.errors import PythonUnsuitable
from blender_addon.solving.pythons import probe_python


def test_this_python_can_solve():
    found = probe_python(Path(sys.executable))
    assert found.python == sys.version.split()[0] and found.numpy == numpy.__version__
    assert found.solver == solver_backend.__version__
    assert (found.devices[:1] == ("CPU",)) == bool(found.torch)


@pytest.mark.skipif(os.name == "nt", reason="a shell script plays the Python")
@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("echo no python here", "does not respond like Python"),
        ("echo 'Segmentation fault' >&2; exit 139", "Segmentation fault"),
        ("""echo '{"python": "3.9.1", "numpy": "", "torch": "", "devices": [], "solver": ""}'""", "3.11 or later"),
        ("""echo '{"python": "3.12.1", "numpy": "", "torch": "", "devices": [], "solver": ""}'""", "has no NumPy"),
    ],
)
def test_what_cannot_solve_is_said(tmp_path, script, message):
    fake = tmp_path / "python"
    fake.write_text(f"#!/bin/sh\n{script}\n")
    fake.chmod(0o755)
    with pytest.raises(PythonUnsuitable, match=message):
        probe_python(fake)


def test_a_missing_python_is_named(tmp_path):
    with pytest.raises(BackendMissing, match="No Python was found"):
        probe_python(tmp_path / "gone")
