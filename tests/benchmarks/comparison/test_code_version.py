"""Test the code version of a method, which includes every module of the package that it imports."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.comparison import code_version as versions
from tests.benchmarks.comparison.code_version import ROOT, closure, code_version
from tests.benchmarks.comparison.methods import compared


def test_code_is_what_a_method_imports() -> None:
    names = {str(path.relative_to(ROOT)) for path in closure("research.baselines.muvs")}
    ours = {"research/baselines/muvs.py", "research/baselines/sequence.py"}
    parts = {"solver_backend/priors/gaussian_vae.py", "solver_backend/cameras/projection.py"}
    assert ours | parts <= names
    assert "solver_backend/fitters/recipes/noise_aware.py" not in names
    assert not any(name.startswith("solver_backend/report") for name in names)
    assert code_version("solver_backend.fitters.pipeline") != code_version("research.baselines.muvs")


@pytest.mark.parametrize("module", sorted({method.module for method in compared()}))
def test_nothing_is_missing_where_only_the_closure_is(tmp_path: Path, module: str) -> None:
    for path in closure(module):
        copy = tmp_path / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    # An installed package comes before folders without this file.
    for folder in [path for path in tmp_path.rglob("*") if path.is_dir()]:
        (folder / "__init__.py").touch()
    code = f"import {module} as found; print(found.__file__)"
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=alone, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(tmp_path)


def test_imports_of_every_form_are_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sources = {
        "__init__.py": "", "start.py": "import solver_backend.plain\nfrom solver_backend import taken\n"
        "def late():\n    from solver_backend.inner import deep\n    import numpy\n",
        "plain.py": "", "taken.py": "from .inner.near import thing\n", "unused.py": "",
        "inner/__init__.py": "from . import opened\n", "inner/deep.py": "from .. import beside\n",
        "inner/near.py": "from .opened import value\n", "inner/opened.py": "", "beside.py": "",
    }  # fmt: skip
    for name, text in sources.items():
        path = tmp_path / "solver_backend" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    monkeypatch.setattr(versions, "ROOT", tmp_path)
    found = {str(path.relative_to(tmp_path / "solver_backend")) for path in closure("solver_backend.start")}
    assert found == set(sources) - {"unused.py"}


@pytest.mark.parametrize(
    ("source", "is_same"),
    [
        (
            '"""Other words."""\nLIMIT = (1.0,\n         2)  # m\n"""Of a step."""\ndef half(x):\n    return x / 2\n',
            True,
        ),
        ("LIMIT = (1.0, 2)\ndef half(x):\n    return x / 2\n", True),
        ("LIMIT = (1.0, 3)\ndef half(x):\n    return x / 2\n", False),
        ('LIMIT = (1.0, 2)\ndef half(x):\n    print("new")\n    return x / 2\n', False),
    ],
)
def test_words_about_the_code_are_no_part_of_its_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, is_same: bool
) -> None:
    monkeypatch.setattr(versions, "ROOT", tmp_path)
    path = tmp_path / "solver_backend" / "start.py"
    path.parent.mkdir()
    path.write_text(
        '"""Words."""\nLIMIT = (1.0, 2)\ndef half(x):\n    """Halve."""\n    return x / 2\n', encoding="utf-8"
    )
    before = code_version.__wrapped__("solver_backend.start")
    path.write_text(source, encoding="utf-8")
    assert (code_version.__wrapped__("solver_backend.start") == before) == is_same


def test_the_version_does_not_depend_on_the_version_of_python() -> None:
    source = 'def row(name, width=8):\n    return f"{name:<{width}} {width!r}"\n'
    parts = [
        f"FormattedValue(value=Name(id='width',ctx=Load()),conversion={conversion})" for conversion in (-1, ord("r"))
    ]
    form = f"JoinedStr(values=[Constant(value='<'),{parts[0]}])"
    name = f"FormattedValue(value=Name(id='name',ctx=Load()),conversion=-1,format_spec={form})"
    arguments = "arguments(args=[arg(arg='name'),arg(arg='width')],defaults=[Constant(value=8)])"
    returned = f"Return(value=JoinedStr(values=[{name},Constant(value=' '),{parts[1]}]))"
    expected = f"Module(body=[FunctionDef(name='row',args={arguments},body=[{returned}])])"
    assert versions._instructions(source) == expected, "the same in Python 3.11, 3.12 and 3.13"
