"""Download the wheels and models of the detector that an extension can include.

Versions are in ``detector_wheels.json``. Wheels come from pip's registry or from a folder. The models are in
MediaPipe's wheel for Linux. The SHA-256 of every file is checked.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

TABLE: dict[str, Any] = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))
PLATFORMS, PYTHONS = tuple(TABLE["platforms"]), tuple(TABLE["pythons"])
_MODELS = f"mediapipe=={TABLE['models']['mediapipe']}"
_MODELS_FOR = ("linux-x64", "3.11")  # Platform and Python of the wheel with the models.


class WheelsMissing(Exception):
    """A wheel is not available, or differs from the table."""


def fetch(
    platform: str, python: str, folder: Path, source: Path | None = None, *, boards: bool = False
) -> tuple[list[Path], Path]:
    """Return the wheels for a platform and a Python, and the wheel with the models.

    Args:
        folder: cache for the wheels.
        source: folder of wheels to use instead of the registry.
        boards: also get OpenCV, which finds calibration boards.

    Raises:
        WheelsMissing: pip fails, or a wheel's SHA-256 differs from the table.
    """
    wanted = TABLE["packages"] | (TABLE["boards"] if boards else {})
    packages = [f"{name}=={version}" for name, version in wanted.items()]
    kept = folder / f"{platform}-{python}"
    _download(packages, platform, python, kept, source)
    _download([_MODELS], *_MODELS_FOR, folder / "models", source)
    names = {name.replace("-", "_") for name in wanted}
    wheels = sorted(path for path in kept.glob("*.whl") if path.name.split("-")[0] in names and _is_known(path))
    models = [path for path in (folder / "models").glob("mediapipe-*.whl") if _is_known(path)]
    if len(wheels) != len(names) or len(models) != 1:
        found = ", ".join(sorted(path.name for path in (*kept.glob("*.whl"), *(folder / "models").glob("*.whl"))))
        message = f"The wheels are not those in supply/detector_wheels.json: {found}. Delete others from {folder}."
        raise WheelsMissing(message)
    return wheels, models[0]


def read_models(wheel: Path) -> dict[str, bytes]:
    """Return the models and licence in MediaPipe's wheel, by the detector's file names."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(member) for name, member in TABLE["models"]["files"].items()}


def _download(packages: list[str], platform: str, python: str, folder: Path, source: Path | None) -> None:
    tags = [word for tag in TABLE["platforms"][platform] for word in ("--platform", tag)]
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    where = [] if source is None else ["--no-index", "--find-links", str(source)]
    words = [*pip, "--only-binary=:all:", *tags, "--python-version", python, *where, "--dest", str(folder), *packages]
    if subprocess.run(words, check=False).returncode:
        raise WheelsMissing(f"pip could not fetch {', '.join(packages)}; see above.")


def _is_known(path: Path) -> bool:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if TABLE["sha256"].get(path.name, digest) != digest:
        raise WheelsMissing(f"The SHA-256 of {path} is not the one in supply/detector_wheels.json.")
    return path.name in TABLE["sha256"]
