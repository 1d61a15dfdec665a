"""The wheels and models of an included detector: fetched by pip, checked by their hashes."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from supply import detector_wheels
from supply.detector_wheels import TABLE, WheelsMissing, fetch, read_models


@pytest.fixture
def registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of wheels that pip downloads, with their hashes in the table."""
    folder = tmp_path / "registry"
    folder.mkdir()
    hashes = {}
    for name, version in {**TABLE["packages"], **TABLE["boards"], "mediapipe": TABLE["models"]["mediapipe"]}.items():
        path = folder / f"{name.replace('-', '_')}-{version}-py3-none-any.whl"
        with zipfile.ZipFile(path, "w") as wheel:
            for member in TABLE["models"]["files"].values():
                wheel.writestr(member, member)
        hashes[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    monkeypatch.setitem(TABLE, "sha256", hashes)

    def pip(words: list[str], check: bool) -> subprocess.CompletedProcess[str]:
        wanted = [word.partition("==")[0].replace("-", "_") for word in words if "==" in word]
        target = Path(words[words.index("--dest") + 1])
        target.mkdir(parents=True, exist_ok=True)
        for path in folder.glob("*.whl"):
            if path.name.split("-")[0] in wanted:
                shutil.copy(path, target)
        return subprocess.CompletedProcess(words, 0 if wanted else 1)

    monkeypatch.setattr(detector_wheels.subprocess, "run", pip)
    return folder


def test_wheels_and_models_are_those_of_the_table(registry: Path, tmp_path: Path) -> None:
    wheels, models = fetch("linux-x64", "3.11", tmp_path / "kept")
    assert [path.name.split("-")[0] for path in wheels] == ["ai_edge_litert", "av"]
    assert read_models(models) == {name: member.encode() for name, member in TABLE["models"]["files"].items()}


def test_opencv_is_included_for_boards_alone(registry: Path, tmp_path: Path) -> None:
    wheels, _ = fetch("linux-x64", "3.11", tmp_path / "kept", boards=True)
    assert [path.name.split("-")[0] for path in wheels] == ["ai_edge_litert", "av", "opencv_python_headless"]
    again, _ = fetch("linux-x64", "3.11", tmp_path / "kept")
    assert again == wheels[:2], "a wheel that was kept before is left out"


def test_a_wheel_of_another_content_is_refused(registry: Path, tmp_path: Path) -> None:
    path = next(registry.glob("av-*.whl"))
    path.write_bytes(path.read_bytes() + b"more")
    with pytest.raises(WheelsMissing, match=r"The SHA-256 of .*av-.* is not the one"):
        fetch("linux-x64", "3.11", tmp_path / "kept")


def test_a_wheel_that_is_not_in_the_table_does_not_count(registry: Path, tmp_path: Path) -> None:
    TABLE["sha256"].pop(next(registry.glob("av-*.whl")).name)
    with pytest.raises(WheelsMissing, match=r"not those in supply/detector_wheels\.json: .*av-17"):
        fetch("linux-x64", "3.11", tmp_path / "kept")


def test_the_table_names_a_wheel_for_every_platform_and_python() -> None:
    names = list(TABLE["sha256"])
    for tag in ("manylinux_2_27_x86_64", "win_amd64", "macosx_12_0_arm64"):
        for python in TABLE["pythons"]:
            version = f"cp{python.replace('.', '')}"
            assert any(name.startswith(f"ai_edge_litert-2.3.0-{version}-{version}-{tag}") for name in names)
