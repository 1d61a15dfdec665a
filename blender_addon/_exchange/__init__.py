"""The exchange library inside the add-on. The zip contains a copy. A checkout uses the solver's folder."""

from pathlib import Path

if not Path(__file__).with_name("errors.py").is_file():
    __path__ = [str(Path(__file__).resolve().parents[2] / "solver_backend" / "exchange")]
