"""Build the extension: one zip with the add-on, the solver, the body and the weights, and a repository's index.

``python build_addon.py [--out DIR]`` writes ``manifold_mocap-<version>.zip`` and beside it what it is made of
(``.cdx.json``, CycloneDX), has Blender's own extension tool validate
it where the ``bpy`` module is installed, and has the same tool write ``index.json``: the folder can then be served by
any web server as an extension repository. Same sources, same bytes.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path

from solver_backend.exchange.outputs import atomic_output, write_text
from solver_backend.exchange.verb import output, parse_script
from supply.bill_of_materials import bill_of_materials

ROOT = Path(__file__).resolve().parent
ADDON, SOLVER = ROOT / "blender_addon", ROOT / "solver_backend"
EXCHANGE = SOLVER / "exchange"
MANIFEST = ADDON / "blender_manifest.toml"
_LEFT_OUT = frozenset({"__pycache__"})
_COMPARED = frozenset({"vposer", "vposer_worded", "rvposer_second_norm"})
"""Priors that a solve is compared with, and the table of all: no user of the extension needs them."""
_SUFFIXES = frozenset({".py", ".toml", ".npz", ".md", ".html", ".css", ".js", ".json", ".txt", ".c3d"})
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The first moment that a zip can hold: the same zip is made at any time."""
_LIMIT_MIB = 13
"""Size of the zip at most, MiB; chosen by hand."""


def main(arguments: list[str] | None = None) -> int:
    """Build, validate and index; return 0 if all went well."""
    folder = output("DIR", "Folder for the zip", ROOT / "dist", kind="folder")
    out = parse_script("Build the Blender extension.", folder, argv=arguments).out
    path = build(out)
    print(f"{path} ({path.stat().st_size / 2**20:.1f} MiB)")
    if path.stat().st_size > _LIMIT_MIB * 2**20:
        print(f"error: the extension is larger than {_LIMIT_MIB} MiB", file=sys.stderr)
        return 1
    tool = extension_tool()
    if tool is None:
        print("not validated, no index: the bpy module, which carries Blender's extension tool, is not installed")
        return 0
    steps = [["validate", str(path)], ["server-generate", "--repo-dir", str(out)]]
    codes = [subprocess.run([sys.executable, str(tool), *step], check=False).returncode for step in steps]
    return max(codes)


def build(out: Path) -> Path:
    """Write the zip and its bill of materials into a folder, replacing older ones, and return the zip's path."""
    manifest = tomllib.loads(MANIFEST.read_text(encoding="utf-8"))
    path = out / f"{manifest['id']}-{manifest['version']}.zip"
    files = contents()
    with (
        atomic_output(path, overwrite=True) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive,
    ):
        for name, source in files.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, source.read_bytes())
    materials = json.dumps(bill_of_materials(path), indent=1)
    write_text(path.with_suffix(".cdx.json"), materials + "\n", overwrite=True)
    return path


def contents() -> dict[str, Path]:
    """Return the files of the extension by their names in the zip, sorted.

    The solver lies in a folder of its own, so that a child process that finds it finds nothing of the add-on.
    The exchange library is in both halves: each imports its own.
    """
    found = {path.relative_to(ADDON).as_posix(): path for path in _files(ADDON)}
    found |= {f"_exchange/{path.relative_to(EXCHANGE).as_posix()}": path for path in _files(EXCHANGE)}
    found |= {f"backend/solver_backend/{path.relative_to(SOLVER).as_posix()}": path for path in _files(SOLVER)}
    found["LICENSE"] = ROOT / "LICENSE"
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
        if path.suffix in _SUFFIXES
        and path.stem not in _COMPARED
        and not _LEFT_OUT.intersection(path.relative_to(folder).parts)
    ]


if __name__ == "__main__":
    sys.exit(main())
