"""Lock the exact package versions that CI installs, with the hashes of their archives."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from solver_backend.exchange.outputs import write_text
from supply.licences import CI_EXTRAS, ROOT, installed

LOCK = ROOT / "requirements-ci.lock"
_OF_THE_MACHINE = "torch"
"""Package with different archives, and so different hashes, for each processor and GPU."""
_HEAD = """\
# Written by python -m supply lock, for Python 3.11. To install: pip install --require-hashes -r requirements-ci.lock
# torch is not among them: its archives differ by processor and GPU.
"""


def write_lock(path: Path = LOCK) -> Path:
    """Write the lock file for the installed versions.

    Raises:
        CalledProcessError: uv cannot resolve the versions, and reports the reason.
    """
    pins = [f"{p.metadata['Name']}=={p.version}" for p in installed(CI_EXTRAS) if p.metadata["Name"] != _OF_THE_MACHINE]
    with tempfile.TemporaryDirectory() as name:
        constraints, overrides, out = (Path(name, part) for part in ("constraints.txt", "overrides.txt", "out.txt"))
        constraints.write_text("\n".join(pins))
        overrides.write_text(f"{_OF_THE_MACHINE} ; python_version < '3'\n")
        extras = [word for extra in CI_EXTRAS for word in ("--extra", extra)]
        options = ["--python-version", "3.11.5", "--generate-hashes", "--no-header", "--no-annotate", "--quiet"]
        files = ["--constraint", constraints, "--override", overrides, "--output-file", out, ROOT / "pyproject.toml"]
        subprocess.run([sys.executable, "-m", "uv", "pip", "compile", *options, *extras, *map(str, files)], check=True)
        return write_text(path, _HEAD + out.read_text(encoding="utf-8"), overwrite=True)
