"""The project's own tool: what it refuses, what it calls, and what it says when a step fails."""

from __future__ import annotations

import ast
import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def dev(monkeypatch, tmp_path):
    """Return the tool with every command recorded instead of run, called from an empty folder."""
    spec = importlib.util.spec_from_file_location("dev", ROOT / "dev.py")
    assert spec is not None and spec.loader is not None
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.commands = []
    module.codes = {}

    def call(command, **options):
        module.commands.append((command, options))
        return next((code for part, code in module.codes.items() if part in command), 0)

    monkeypatch.setattr(module, "call", call)
    monkeypatch.setattr(module, "set_up", lambda: None)
    monkeypatch.chdir(tmp_path)
    return module


def verbs(dev) -> list[str]:
    return [command[3] for command, _ in dev.commands]


def test_the_demo_solves_the_embedded_capture_into_a_new_folder(dev, tmp_path, capsys):
    assert dev.main(["demo"]) == 0
    assert verbs(dev) == ["dataset demo", "solve", "evaluate", "bake"]
    out = tmp_path / "demo_embedded"
    assert [command[1:3] for command, _ in dev.commands] == [["-m", "solver_backend"]] * 3 + [["-m", "blender_addon"]]
    assert f"{out / 'report.html'}" in dev.commands[1][0]
    shown = capsys.readouterr().out
    assert "[5/5] Bake in Blender" in shown
    assert str(out) in shown
    assert dev.main(["demo"]) == 0
    assert (tmp_path / "demo_embedded_2").is_dir()


def test_the_demo_of_markers_takes_the_embedded_recording_or_a_c3d(dev, tmp_path):
    assert dev.main(["demo", "--markers"]) == 0
    assert verbs(dev) == ["dataset demo", "solve", "bake"] and "--markers" in dev.commands[0][0]
    assert (tmp_path / "demo_embedded_markers").is_dir()
    take = tmp_path / "walk.c3d"
    take.touch()
    assert dev.main(["demo", str(take), "--subject-prefix", "Anna"]) == 0
    convert = dev.commands[3][0]
    assert convert[3:5] == ["convert", str(take)] and "--subject-prefix=Anna" in convert
    assert (tmp_path / "demo_walk").is_dir()
    with pytest.raises(SystemExit):
        dev.main(["demo", str(take), "--markers"])


def test_the_demo_takes_any_capture_and_says_where_results_go(dev, tmp_path, capsys):
    take, out = tmp_path / "take", tmp_path / "deep" / "results"
    take.mkdir()
    options = ["--fps", "50", "--up-axis=-y", "--trim", "--backend", "torch"]
    assert dev.main(["demo", "take", "--out", str(out), *options]) == 0
    assert verbs(dev) == ["convert", "solve", "bake"]
    convert, solve, bake = (command for command, _ in dev.commands)
    assert convert[4:] == [str(take), "--out", str(out / "capture.npz"), "--fps=50.0", "--up-axis=-y", "--trim"]
    assert solve[-2:] == ["--backend", "torch"]
    motion, capture = str(out / "motion.npz"), str(out / "capture.npz")
    assert bake[4:-2] == [motion, "--capture", capture, "--out", str(out)]
    assert bake[-2:] == ["--footage-from", str(take)], "it lies in the folder that was chosen"


def test_a_folder_that_is_not_empty_is_left_alone(dev, tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_text("")
    assert dev.main(["demo", "--out", "mine"]) == 2
    assert "mine exists and is not empty." in capsys.readouterr().err
    assert dev.main(["demo", "--out", "mine/file"]) == 2
    assert dev.main(["demo", "--out", "mine/file/under"]) == 2
    assert "is not writable: Not a directory" in capsys.readouterr().err
    assert dev.commands == []


def test_what_a_killed_run_left_does_not_make_a_folder_taken(dev, tmp_path):
    (tmp_path / "mine").mkdir()
    for name in (".probe", ".part-0123456789abcdef"):
        (tmp_path / "mine" / name).write_text("")
    assert dev.main(["demo", "--out", "mine"]) == 0
    assert verbs(dev)[-1] == "bake"


def test_a_capture_that_is_not_there_is_refused_before_anything_is_made(dev, tmp_path, capsys):
    assert dev.main(["demo", "absent"]) == 2
    assert "There is no capture at absent." in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_stage_that_fails_ends_the_demo_with_its_exit_code(dev, tmp_path, capsys):
    dev.codes["solve"] = 3
    assert dev.main(["demo"]) == 3
    assert verbs(dev) == ["dataset demo", "solve"]
    assert "This stage failed (exit code 3)." in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_what_was_finished_before_a_failure_is_kept(dev, tmp_path, monkeypatch, capsys):
    def call(command, **options):
        (tmp_path / "demo_embedded" / "capture.npz").touch()
        return 0 if "dataset demo" in command else 130

    monkeypatch.setattr(dev, "call", call)
    assert dev.main(["demo"]) == 130
    assert f"Finished files are in {tmp_path / 'demo_embedded'}." in capsys.readouterr().err
    assert [p.name for p in (tmp_path / "demo_embedded").iterdir()] == ["capture.npz"]


def test_checks_and_tests_are_a_tool_of_their_own(dev):
    assert dev.main(["test", "-k", "name"]) == 0
    assert dev.main(["lint", "--fix"]) == 0
    dev.codes["lint"] = 1
    assert dev.main(["lint"]) == 1
    called = [command[1:] for command, _ in dev.commands]
    checks = ["-m", "supply.checks"]
    assert called == [[*checks, "test", "-k", "name"], [*checks, "lint", "--fix"], [*checks, "lint"]]


@pytest.mark.parametrize("argv", [[], ["fly"], ["lint", "--hard"], ["demo", "--method", "magic"]])
def test_a_wrong_command_line_is_exit_code_2(dev, argv, capsys):
    with pytest.raises(SystemExit) as stop:
        dev.main(argv)
    assert stop.value.code == 2
    assert dev.commands == []


@pytest.fixture
def tool(dev, monkeypatch, tmp_path):
    """Return the tool with an environment of its own in an empty folder, and its real ``set_up``."""
    spec = importlib.util.spec_from_file_location("dev", ROOT / "dev.py")
    assert spec is not None and spec.loader is not None
    fresh: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fresh)
    (tmp_path / "pyproject.toml").write_text("[project]\n")
    for name, value in {"ROOT": tmp_path, "VENV": tmp_path / ".venv", "STAMP": tmp_path / "stamp"}.items():
        monkeypatch.setattr(fresh, name, value)
    fresh.codes, fresh.commands = dev.codes, dev.commands
    monkeypatch.setattr(fresh, "call", dev.call)
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.setattr(fresh, "blender_error", lambda: "")
    return fresh


def test_set_up_installs_everything_in_one_step_and_only_once(tool, monkeypatch, tmp_path):
    monkeypatch.setenv("PIP_FIND_LINKS", "some folder")
    monkeypatch.delenv("UV_FIND_LINKS", raising=False)
    monkeypatch.setattr(tool, "PYTHON", Path(sys.executable))
    tool.set_up()
    installs = [(command, options) for command, options in tool.commands if "install" in command]
    assert [command[2] for command, _ in installs] == ["pip", "uv"]
    command, options = installs[1]
    assert command[-2:] == ["--editable", f"{tmp_path}[torch,bpy,capture,oak,train,scale,dev]"]
    assert options["env"]["UV_FIND_LINKS"] == "some folder"
    before = len(tool.commands)
    tool.set_up()
    assert len(tool.commands) == before
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'changed'\n")
    tool.set_up()
    assert len(tool.commands) > before


@pytest.mark.parametrize("has_archives", [True, False])
def test_ci_installs_the_locked_versions_where_they_can_be_had(tool, monkeypatch, tmp_path, has_archives):
    monkeypatch.setenv("CI", "true")
    monkeypatch.setattr(tool, "PYTHON", Path(sys.executable))
    monkeypatch.setattr(tool, "LOCK", tmp_path / "requirements-ci.lock")
    tool.LOCK.write_text("numpy==1.26.4 --hash=sha256:0\n")
    tool.codes |= {} if has_archives else {"--constraint": 2}
    tool.set_up()
    installs = [command for command, _ in tool.commands if "--editable" in command]
    assert installs[0][installs[0].index("--constraint") + 1] == str(tool.LOCK)
    assert ["--constraint" in command for command in installs] == ([True] if has_archives else [True, False])


@pytest.mark.parametrize("failing", ["uv>=0.5", "uv"])
def test_pip_steps_in_where_uv_cannot_be_had_or_fails(tool, monkeypatch, failing):
    tool.codes[failing] = 1
    monkeypatch.setattr(tool, "PYTHON", Path(sys.executable))
    tool.set_up()
    last = [command for command, _ in tool.commands if "install" in command][-1]
    assert last[2] == "pip"
    assert "--editable" in last


def test_a_failed_install_is_told_and_tried_again_next_time(tool, monkeypatch):
    tool.codes["--editable"] = 1
    monkeypatch.setattr(tool, "PYTHON", Path(sys.executable))
    with pytest.raises(tool.Failed, match="The packages could not be installed"):
        tool.set_up()
    assert not tool.STAMP.exists()


def test_missing_system_libraries_are_named_and_never_installed_without_root(tool, monkeypatch):
    monkeypatch.setattr(tool, "blender_error", lambda: "libXi.so.6: cannot open shared object file")
    monkeypatch.setattr(tool.shutil, "which", lambda name: "/usr/bin/apt-get")
    monkeypatch.setattr(tool.os, "geteuid", lambda: 1000, raising=False)
    with pytest.raises(tool.Failed, match="libXi.so.6: cannot open shared object file") as raised:
        tool.check_blender()
    assert "Run as root: apt-get install -y --no-install-recommends libx11-6 libxrender1" in raised.value.hint
    assert tool.commands == []


def test_root_gets_the_system_libraries_installed(tool, monkeypatch):
    errors = iter(["libXi.so.6: cannot open shared object file", ""])
    monkeypatch.setattr(tool, "blender_error", lambda: next(errors))
    monkeypatch.setattr(tool.shutil, "which", lambda name: "/usr/bin/apt-get")
    monkeypatch.setattr(tool.os, "geteuid", lambda: 0, raising=False)
    tool.check_blender()
    assert [command[1] for command, _ in tool.commands] == ["update", "install"]


@pytest.mark.skipif(os.name == "nt", reason="the stand-in is a shell script")
def test_another_python_looks_for_3_11_and_explains(tmp_path):
    code = (
        "import importlib.util, sys; spec = importlib.util.spec_from_file_location('dev', sys.argv.pop(1));"
        "dev = importlib.util.module_from_spec(spec); spec.loader.exec_module(dev);"
        "dev.WANTED = (3, 99); dev.IS_WANTED = 'import sys; sys.exit(1)'; sys.exit(dev.with_wanted_python())"
    )
    done = subprocess.run([sys.executable, "-c", code, str(ROOT / "dev.py"), "test"], capture_output=True, text=True)
    assert done.returncode == 1
    assert "needs Python 3.99, which was not found." in done.stderr
    assert "then run: python3.99 dev.py" in done.stderr


def test_a_chosen_python_has_its_own_environment(dev, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["dev.py", "test", "--python", "3.13", "tests/io"])
    monkeypatch.setenv("MOCAP_DEV_PYTHON", "3.11")
    assert dev.with_wanted_python() == 0
    assert [command[2:] for command, _ in dev.commands] == [["test", "tests/io"]]
    spec = importlib.util.spec_from_file_location("dev", ROOT / "dev.py")
    assert spec is not None and spec.loader is not None
    chosen: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(chosen)
    assert chosen.WANTED == (3, 13) and chosen.VENV == ROOT / ".venv-3.13"


def test_detectors_get_an_environment_of_their_own(dev, monkeypatch):
    monkeypatch.setattr(dev, "set_up", lambda: pytest.fail("the environment was made"))
    assert dev.main(["detectors"]) == 0
    assert [command[1:] for command, _ in dev.commands] == [["-m", "supply.detectors"]]


def test_an_older_python_can_start_it_and_look_for_3_11() -> None:
    """The project's modules need 3.11, so none is imported before the Python is known."""
    nodes = ast.parse((ROOT / "dev.py").read_text(encoding="utf-8")).body
    imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    assert imported and {name.partition(".")[0] for name in imported} <= sys.stdlib_module_names
