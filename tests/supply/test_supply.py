"""The bill of materials names what the zip holds, licences are stated, and versions are locked without an index."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
import zipfile
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest

from supply.bill_of_materials import bill_of_materials
from supply.licences import ROOT, installed, licence_of, licence_table
from supply.lock import LOCK

MANIFEST = 'id = "x"\nversion = "1.2.3"\nlicense = ["SPDX:GPL-3.0-or-later"]\n'


def test_the_bill_names_wheels_and_assets_with_their_hashes(tmp_path: Path) -> None:
    files = {"blender_manifest.toml": MANIFEST, "wheels/a_b-1.5-py3-none-any.whl": "w", "backend/body.npz": "n"}
    with zipfile.ZipFile(tmp_path / "x.zip", "w") as archive:
        for name, content in (files | {"code.py": "1"}).items():
            archive.writestr(name, content)
    bill = json.loads(json.dumps(bill_of_materials(tmp_path / "x.zip")))
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.5")
    whole = bill["metadata"]["component"]
    assert (whole["name"], whole["version"]) == ("x", "1.2.3")
    assert whole["licenses"] == [{"expression": "GPL-3.0-or-later"}]
    assert whole["hashes"][0]["content"] == hashlib.sha256((tmp_path / "x.zip").read_bytes()).hexdigest()
    wheel, body = bill["components"]
    assert (wheel["purl"], wheel["version"]) == ("pkg:pypi/a-b@1.5", "1.5")
    assert (body["name"], body["hashes"][0]["content"]) == ("backend/body.npz", hashlib.sha256(b"n").hexdigest())


def test_every_version_of_the_project_has_both_bounds() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [*project["dependencies"], *(line for extra in project["optional-dependencies"].values() for line in extra)]
    assert [line for line in lines if not ("<" in line.split(";")[0] and ">=" in line.split(";")[0])] == []


def test_the_lock_has_exact_versions_hashes_and_no_index() -> None:
    text = LOCK.read_text(encoding="utf-8")
    assert not re.search(r"https?:|index-url|find-links", text)
    entries = re.split(r"\n(?=\S)", "\n".join(line for line in text.splitlines() if not line.startswith("#")))
    assert len(entries) > 40
    assert [e for e in entries if not re.match(r"\S+==\S+.*\\\n    --hash=sha256:[0-9a-f]{64}", e)] == []


def test_what_the_project_names_is_locked() -> None:
    locked = {name.lower() for name in re.findall(r"(?m)^([\w.\-]+)==", LOCK.read_text(encoding="utf-8"))}
    assert {"numpy", "array-api-compat", "pytest", "ruff", "bpy"} <= locked
    assert "torch" not in locked


def test_every_package_states_a_licence() -> None:
    assert "not stated" not in licence_table()


@pytest.mark.parametrize(("held", "licence"), [("", "none, because it has no files"), ("code.py,,\n", "not stated")])
def test_a_package_without_files_needs_no_licence(tmp_path: Path, held: str, licence: str) -> None:
    folder = tmp_path / "lists-1.0.dist-info"
    folder.mkdir()
    (tmp_path / "code.py").touch()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: lists\nVersion: 1.0\n")
    (folder / "RECORD").write_text(f"{folder.name}/METADATA,,\n{held}")
    assert licence_of(PathDistribution(folder)) == licence


def test_licences_of_packages_are_told_with_the_terms_of_the_data() -> None:
    packages = {package.metadata["Name"]: licence_of(package) for package in installed(("dev",))}
    assert {"numpy", "pytest", "ruff", "pluggy"} <= set(packages), "those that others need are there too"
    assert packages["ruff"] == "MIT" and "BSD" in packages["numpy"]
    table = licence_table()
    assert "| numpy |" in table and "CC0-1.0" in table
