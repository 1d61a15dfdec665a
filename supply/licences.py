"""List the licences of all required packages, and the terms of the data behind the included files."""

from __future__ import annotations

import re
import tomllib
from email.message import Message
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import cast

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
CI_EXTRAS = ("bpy", "capture", "oak", "train", "scale", "dev")
DATA = (
    ("CMU motion capture (mocap.cs.cmu.edu)", "free to copy, modify and redistribute, no direct resale", "weights"),
    ("UI-PRMD (Vakanski et al. 2018)", "ODC PDDL 1.0", "weights"),
    ("Quaternius and Mesh2Motion animations", "CC0-1.0", "weights"),
    ("MakeHuman motions", "CC0-1.0", "weights"),
    ("Pose2Sim's demo recording (perfanalytics, 2022)", "BSD-3-Clause", "picture of the README"),
    ("ANSUR II (US Army, 2012)", "public survey, summary statistics only", "body"),
)
"""Data sources of included files, with terms and files. See the model cards."""


def installed(extras: tuple[str, ...]) -> list[Distribution]:
    """Return the installed packages that the project requires with these extras, sorted by name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *(line for extra in extras for line in project["optional-dependencies"][extra])]
    found: dict[str, Distribution] = {}
    open_ends = [Requirement(line) for line in wanted]
    while open_ends:
        requirement = open_ends.pop()
        name = plain_name(requirement.name)
        if not _applies(requirement, {""}):
            continue
        try:
            package = distribution(requirement.name)
        except PackageNotFoundError:
            continue
        needs = [Requirement(line) for line in package.requires or ()]
        if name not in found or requirement.extras:
            found[name] = package
            open_ends += [need for need in needs if _applies(need, requirement.extras or {""})]
    return [found[name] for name in sorted(found)]


def licence_table() -> str:
    """Return tables of packages with licences, and of data with terms, as Markdown."""
    lines = ["| package | version | licence |", "|---|---|---|"]
    lines += [f"| {p.metadata['Name']} | {p.version} | {licence_of(p)} |" for p in installed(CI_EXTRAS)]
    lines += ["", "| data | terms | in |", "|---|---|---|", *(f"| {a} | {b} | {c} |" for a, b, c in DATA)]
    return "\n".join(lines)


def licence_of(package: Distribution) -> str:
    """Return a package's licence from its SPDX expression, classifiers, or licence text."""
    metadata = cast(Message, package.metadata)
    stated = metadata.get("License-Expression")
    classifiers = [c.split(" :: ")[-1] for c in metadata.get_all("Classifier") or () if c[:7] == "License"]
    files = [package.read_text(f"licenses/{name}") or "" for name in metadata.get_all("License-File") or ()]
    text = "\n".join([metadata.get("License") or "", *files]).strip().splitlines()
    found = stated or ", ".join(classifiers) or (text[0][:60] if text else "")
    return found or ("none, because it has no files" if _is_empty(package) else "not stated")


def _is_empty(package: Distribution) -> bool:
    """Return whether a package contains no files, like some CUDA packages, so that no licence applies."""
    files = package.files
    return files is not None and all(file.parts[0].endswith(".dist-info") for file in files)


def _applies(requirement: Requirement, extras: set[str]) -> bool:
    marker = requirement.marker
    return marker is None or any(marker.evaluate({"extra": extra}) for extra in extras)


def plain_name(name: str) -> str:
    """Return a package's name in the spelling of the package index."""
    return re.sub(r"[-_.]+", "-", name).lower()
