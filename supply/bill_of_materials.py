"""List the components of the built extension in CycloneDX form, with Python's standard library only."""

from __future__ import annotations

import hashlib
import tomllib
import zipfile
from pathlib import Path


def bill_of_materials(extension: Path) -> dict[str, object]:
    """List the built extension, its wheels and its assets with hashes, in CycloneDX 1.5."""
    manifest_name = "blender_manifest.toml"
    with zipfile.ZipFile(extension) as archive:
        manifest = tomllib.loads(archive.read(manifest_name).decode())
        components = [_component(name, archive.read(name)) for name in archive.namelist() if _is_material(name)]
    whole = {"type": "application", "name": manifest["id"], "version": manifest["version"]}
    whole["licenses"] = [{"expression": manifest["license"][0].removeprefix("SPDX:")}]
    whole["hashes"] = [_hash(extension.read_bytes())]
    return {
        "bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1,
        "metadata": {"component": whole}, "components": components,
    }  # fmt: skip


def _is_material(name: str) -> bool:
    return name.endswith((".whl", ".npz"))


def _component(name: str, data: bytes) -> dict[str, object]:
    path = Path(name)
    if path.suffix == ".whl":
        project, version = path.name.split("-")[:2]
        plain = project.replace("_", "-").lower()
        purl = {"purl": f"pkg:pypi/{plain}@{version}", "version": version}
        return {"type": "library", "name": plain, **purl, "hashes": [_hash(data)]}
    return {"type": "data", "name": name, "hashes": [_hash(data)]}


def _hash(data: bytes) -> dict[str, str]:
    return {"alg": "SHA-256", "content": hashlib.sha256(data).hexdigest()}
