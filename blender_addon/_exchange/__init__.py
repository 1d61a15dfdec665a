"""The exchange library inside the add-on: real files in the zip, the solver's folder in a checkout."""

from pathlib import Path

if not Path(__file__).with_name("errors.py").is_file():
    __path__ = [str(Path(__file__).resolve().parents[2] / "solver_backend" / "exchange")]
