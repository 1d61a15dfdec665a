"""Wheels and npm packages that hold next to nothing, for the set-up of a detector without a network."""

from __future__ import annotations

import io
import tarfile
import zipfile
from pathlib import Path


def litert_wheels(folder: Path) -> None:
    """Write what *Set Up Detector* installs for LiteRT: two wheels, and packages with models of hands and people."""
    folder.mkdir()
    own = {"ai_edge_litert/__init__.py": "", "ai_edge_litert/interpreter.py": ""}
    _write_wheel(folder, "ai_edge_litert", "2.3.0", own)
    _write_wheel(folder, "numpy", "2.2.0", {"numpy/__init__.py": ""})
    _write_package(folder / "mediapipe-hands-0.4.1675469240.tgz", "hand_landmark_full.tflite", "hands.js")
    _write_package(folder / "mediapipe-pose-0.5.tgz", "pose_landmark_lite.tflite", "pose_landmark_full.tflite")


def _write_package(path: Path, *names: str) -> None:
    with tarfile.open(path, "w:gz") as package:
        for name in names:
            member = tarfile.TarInfo(f"package/{name}")
            member.size = 5
            package.addfile(member, io.BytesIO(b"model"))


def _write_wheel(folder: Path, name: str, version: str, files: dict[str, str]) -> None:
    own = f"{name}-{version}.dist-info"
    files = {
        **files, f"{own}/METADATA": f"Metadata-Version: 2.1\nName: {name.replace('_', '-')}\nVersion: {version}\n",
        f"{own}/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }  # fmt: skip
    record = "".join(f"{path},,\n" for path in (*files, f"{own}/RECORD"))
    with zipfile.ZipFile(folder / f"{name}-{version}-py3-none-any.whl", "w") as wheel:
        for path, text in {**files, f"{own}/RECORD": record}.items():
            wheel.writestr(path, text)
