"""Build the extension: one zip with the add-on, the solver, the body and the weights.

``python build_addon.py [--out DIR]`` writes ``manifold_mocap-<version>.zip`` and has Blender's own extension tool
validate it where the ``bpy`` module is installed. Same sources, same bytes.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parent
ADDON, SOLVER = ROOT / "blender_addon", ROOT / "solver_backend"
_LEFT_OUT = frozenset({"__pycache__", "training"})
_SUFFIXES = frozenset({".py", ".toml", ".npz", ".md", ".html", ".css", ".js", ".json", ".txt"})
_EPOCH = (1980, 1, 1, 0, 0, 0)
_LIMIT_MIB = 25


def main(arguments: list[str] | None = None) -> int:
    """Build and validate; return 0 if both went well."""
    parser = argparse.ArgumentParser(description="Build the Blender extension.")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the zip (default: dist)")
    out = parser.parse_args(arguments).out
    path = build(out)
    print(f"{path} ({path.stat().st_size / 2**20:.1f} MiB)")
    if path.stat().st_size > _LIMIT_MIB * 2**20:
        print(f"error: the extension is larger than {_LIMIT_MIB} MiB", file=sys.stderr)
        return 1
    tool = extension_tool()
    if tool is None:
        print("not validated: the bpy module, which carries Blender's extension tool, is not installed")
        return 0
    return subprocess.run([sys.executable, str(tool), "validate", str(path)], check=False).returncode


def build(out: Path) -> Path:
    """Write the zip into a folder, replacing an older one, and return its path."""
    manifest = tomllib.loads((ADDON / "blender_manifest.toml").read_text(encoding="utf-8"))
    path = out / f"{manifest['id']}-{manifest['version']}.zip"
    out.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".part")
    try:
        with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name, source in contents().items():
                entry = zipfile.ZipInfo(name, _EPOCH)
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, source.read_bytes())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def contents() -> dict[str, Path]:
    """Return the files of the extension by their names in the zip, sorted."""
    found = {path.relative_to(ADDON).as_posix(): path for path in _files(ADDON)}
    found |= {f"solver_backend/{path.relative_to(SOLVER).as_posix()}": path for path in _files(SOLVER)}
    licence = ROOT / "LICENSE"
    if licence.is_file():
        found["LICENSE"] = licence
    return dict(sorted(found.items()))


def extension_tool() -> Path | None:
    """Return Blender's extension tool inside the installed ``bpy`` module, None if there is none."""
    spec = find_spec("bpy")
    if spec is None or spec.origin is None:
        return None
    pattern = "*/scripts/addons_core/bl_pkg/cli/blender_ext.py"
    return next(iter(sorted(Path(spec.origin).parent.glob(pattern))), None)


def _files(folder: Path) -> list[Path]:
    return [
        path
        for path in folder.rglob("*")
        if path.suffix in _SUFFIXES and not _LEFT_OUT.intersection(path.relative_to(folder).parts)
    ]


if __name__ == "__main__":
    sys.exit(main())
