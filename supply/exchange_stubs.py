"""Write type stubs for the modules of ``blender_addon._exchange``.

That package takes its modules from ``solver_backend/exchange`` at run time, which type checkers cannot follow. Git
ignores the stubs. Run ``python -m supply.exchange_stubs`` before calling pyrefly or an editor directly.
"""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def write_stubs(root: Path = ROOT) -> None:
    """Write a stub for each module of the exchange library, and delete the stubs of removed modules."""
    library, package = root / "solver_backend" / "exchange", root / "blender_addon" / "_exchange"
    wanted = {path.relative_to(library).with_suffix(".pyi") for path in library.rglob("*.py")}
    for stub in package.rglob("*.pyi"):
        if stub.relative_to(package) not in wanted:
            stub.unlink()
    for name in wanted:
        module = ".".join(("solver_backend", "exchange", *name.with_suffix("").parts)).removesuffix(".__init__")
        path = package / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"from {module} import *\n", encoding="utf-8")


if __name__ == "__main__":
    write_stubs()
