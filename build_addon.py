"""Build the extension's zip with the add-on, the solver, the body and the weights, and a repository index.

``python build_addon.py [--out DIR]`` writes ``manifold_mocap-<version>.zip`` and its bill of materials (``.cdx.json``,
CycloneDX). If the ``bpy`` module is installed, Blender's own extension tool validates the zip and writes
``index.json``. Any web server can then serve the folder as an extension repository. The same sources give the same
bytes.

``--with-detector PLATFORM`` writes a larger zip for one platform and one Python version of Blender. It includes LiteRT,
PyAV and MediaPipe's models, so that it reads videos without any installation. ``--with-boards`` adds OpenCV, which
finds calibration boards.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
import zipfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from solver_backend.exchange.outputs import atomic_output, write_text
from solver_backend.exchange.verb import flag, option, output, parse_script, values
from supply.bill_of_materials import bill_of_materials
from supply.detector_wheels import PLATFORMS, PYTHONS, WheelsMissing, fetch, read_models

ROOT = Path(__file__).resolve().parent
ADDON, SOLVER = ROOT / "blender_addon", ROOT / "solver_backend"
EXCHANGE = SOLVER / "exchange"
MANIFEST = ADDON / "blender_manifest.toml"
_LEFT_OUT = frozenset({"__pycache__"})
_COMPARED = frozenset({"vposer", "vposer_worded", "rvposer_second_norm"})
"""Priors that only comparisons need. The extension omits them."""
_SUFFIXES = frozenset({".py", ".toml", ".npz", ".md", ".html", ".css", ".js", ".json", ".txt", ".c3d"})
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Earliest time that a zip can store. With a constant time, the same sources give the same zip."""
_LIMIT_MIB = 13
"""Largest size of the zip in MiB. Chosen by hand."""


def main(arguments: list[str] | None = None) -> int:
    """Build the extension, validate it and write the index. Return the exit code."""
    args = parse_script("Build the Blender extension.", *_OPTIONS, argv=arguments)
    out = args.out
    if args.with_boards and args.with_detector is None:
        print("error: --with-boards needs --with-detector", file=sys.stderr)
        return 1
    try:
        detector = None
        if args.with_detector is not None:
            detector = read_detector(args.with_detector, args.python, args.wheels, boards=args.with_boards)
    except WheelsMissing as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    path = build(out, detector)
    print(f"{path} ({path.stat().st_size / 2**20:.1f} MiB)")
    if detector is None and path.stat().st_size > _LIMIT_MIB * 2**20:
        print(f"error: the extension is larger than {_LIMIT_MIB} MiB", file=sys.stderr)
        return 1
    tool = extension_tool()
    if tool is None:
        print("not validated, no index: the bpy module, which carries Blender's extension tool, is not installed")
        return 0
    steps = [["validate", str(path)], ["server-generate", "--repo-dir", str(out)]]
    codes = [subprocess.run([sys.executable, str(tool), *step], check=False).returncode for step in steps]
    return max(codes)


_OPTIONS = (
    output("DIR", "Folder for the zip", ROOT / "dist", kind="folder"),
    option("choice", "with_detector", "PLATFORM", "Platform to include a detector for", choices=values(*PLATFORMS)),
    flag("with_boards", "Include OpenCV with the detector, to calibrate from boards"),
    option("choice", "python", "VERSION", "Python of the Blender that the detector is for: 3.11 in Blender 4.2 to 4.5",
           PYTHONS[0], choices=values(*PYTHONS)),
    option("folder", "wheels", "DIR", "Folder of wheels to take instead of the package registry's"),
)  # fmt: skip


@dataclass(frozen=True)
class Detector:
    """Wheels and models of a detector for one platform and Python."""

    platform: str
    python: str
    wheels: tuple[Path, ...]
    models: dict[str, bytes]  # By file name.

    @property
    def finds_boards(self) -> bool:
        """True if OpenCV is included, which finds calibration boards."""
        return any(path.name.startswith("opencv") for path in self.wheels)

    def in_manifest(self, text: str) -> str:
        """Add the platform and the wheels to the text of the manifest."""
        lines = [f'platforms = ["{self.platform}"]', "wheels = ["]
        lines += [*(f'    "./wheels/{path.name}",' for path in self.wheels), "]", ""]
        before, permissions, after = text.partition("[permissions]")
        return before + "\n".join(lines) + "\n" + permissions + after


def read_detector(platform: str, python: str, source: Path | None = None, *, boards: bool = False) -> Detector:
    """Fetch the wheels of a detector, and read its models (see ``supply.detector_wheels.fetch``)."""
    wheels, models = fetch(platform, python, ROOT / "dist" / "wheels", source, boards=boards)
    return Detector(platform, python, tuple(wheels), read_models(models))


def build(out: Path, detector: Detector | None = None) -> Path:
    """Write the zip and its bill of materials to a folder, and return the zip's path."""
    text = MANIFEST.read_text(encoding="utf-8")
    manifest = tomllib.loads(text)
    files: dict[str, Path | bytes] = {**contents()}
    name = f"{manifest['id']}-{manifest['version']}"
    if detector is not None:
        name += f"-{detector.platform}-python{detector.python}{'-boards' * detector.finds_boards}"
        files[MANIFEST.name] = detector.in_manifest(text).encode()
        files |= {f"wheels/{path.name}": path for path in detector.wheels}
        files |= {f"backend/detector/{name}": data for name, data in detector.models.items()}
    path = out / f"{name}.zip"
    with (
        atomic_output(path, overwrite=True) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive,
    ):
        for name, source in sorted(files.items()):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, source if isinstance(source, bytes) else source.read_bytes())
    materials = json.dumps(bill_of_materials(path), indent=1)
    write_text(path.with_suffix(".cdx.json"), materials + "\n", overwrite=True)
    return path


def contents() -> dict[str, Path]:
    """Return the files of the extension by their names in the zip, sorted.

    The solver is in its own folder, from which a child process cannot import the add-on. Both contain the exchange
    library, and each one imports its own copy.
    """
    found = {path.relative_to(ADDON).as_posix(): path for path in _files(ADDON)}
    found |= {f"_exchange/{path.relative_to(EXCHANGE).as_posix()}": path for path in _files(EXCHANGE)}
    found |= {f"backend/solver_backend/{path.relative_to(SOLVER).as_posix()}": path for path in _files(SOLVER)}
    found["LICENSE"] = ROOT / "LICENSE"
    return dict(sorted(found.items()))


def extension_tool() -> Path | None:
    """Return the path of Blender's extension tool in the installed ``bpy`` module, or None without one."""
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
