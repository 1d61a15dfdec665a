"""``python -m tests.gui``: the built extension in a real Blender with a screen, used by clicks.

Needs the real recording (``MOCAP_SHARED_DATA``) and a script that gives a real Blender a screen
(``MOCAP_REAL_BLENDER``, with the verbs run, gui and shot).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import build_addon
from tests.gui.recordings import lay_out
from tests.gui.renew import CLIP, IMAGES, renew, write_animation

HERE = Path(__file__).parent
_INSIDE = Path("/work_io")
_OWN_MEMORY = "Not freed memory blocks: 4294967295"
"""Blender 5.2.2 counted to -1 at the end of one run of three; Python cannot free its blocks."""
WITH_DETECTOR = ("videos.py",)  # Scripts that need the zip that includes a detector.
_HARMLESS = ("EGL_BAD_MATCH", "libEGL", "MESA", "ALSA", "XDG_RUNTIME_DIR", "unable to open", _OWN_MEMORY)


def missing() -> str:
    """Return what this machine lacks, '' if nothing."""
    tool, data = os.environ.get("MOCAP_REAL_BLENDER"), os.environ.get("MOCAP_SHARED_DATA")
    if not tool or not Path(tool).is_file():
        return "MOCAP_REAL_BLENDER does not name the script that gives a real Blender a screen"
    if not data or not (Path(data) / "multiview" / "pose2sim").is_dir():
        return "MOCAP_SHARED_DATA does not name the folder of real recordings"
    return ""


def run(suite: str, out: Path, script: str = "workflow.py", seconds: float = 1500) -> dict[str, object]:
    """Build, install, play a script and return its record; pictures and console log lie in ``out``.

    Raises:
        RuntimeError: the extension does not install or Blender does not end.
    """
    shutil.rmtree(out, ignore_errors=True)
    pictures = out / "pictures"
    pictures.mkdir(parents=True)
    archive = build_addon.build(out, _detector(suite) if script in WITH_DETECTOR else None)
    for name in ("support", "gui"):
        shutil.copytree(HERE.parent / name, out / "tests" / name, ignore=shutil.ignore_patterns("__pycache__"))
    lay_out(out, script)
    install = ["blender", "--command", "extension", "install-file", "-r", "user_default", "-e"]
    done = subprocess.run(
        _tool("run", suite, [*install, f"{_INSIDE}/{archive.name}"]), env=_environment(out), check=False
    )
    if done.returncode != 0:
        raise RuntimeError("The extension does not install.")
    blender = ["blender", "--enable-event-simulate", "--window-geometry", "0", "0", "1600", "900"]
    gui = f"{_INSIDE}/tests/gui"
    played = [*blender, "--python", f"{gui}/driver.py", "--", f"{_INSIDE}/pictures", f"{gui}/{script}"]
    with (out / "console.log").open("w") as log:
        process = subprocess.Popen(
            _tool("gui", suite, played),
            env=_environment(out),
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            _serve(process, pictures, suite, out, time.monotonic() + seconds)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
                process.wait()
    record = json.loads((pictures / "record.json").read_text()) if (pictures / "record.json").exists() else {}
    record["console"] = [line for line in (out / "console.log").read_text().splitlines() if _is_error(line)]
    record["left_behind"] = _left_behind(process.pid, time.monotonic() + 10)
    return record


def _detector(suite: str) -> build_addon.Detector:
    """Return the detector for Blender's own Python."""
    words = ["blender", "--background", "--python-expr", "import sys; print('python', *sys.version_info[:2])"]
    done = subprocess.run(_tool("run", suite, words), capture_output=True, text=True, check=True)
    _, major, minor = next(line for line in done.stdout.splitlines() if line.startswith("python ")).split()
    return build_addon.read_detector("linux-x64", f"{major}.{minor}")


def _left_behind(session: int, end: float) -> list[str]:
    """Return the solvers of Blender's session that outlive it by ten seconds."""
    while True:
        processes = [path.parent for path in Path("/proc").glob("[0-9]*/cmdline")]
        commands = [_command(path) for path in processes if _session(path) == session]
        found = [command for command in commands if "solver_backend" in command]
        if not found or time.monotonic() > end:
            return found
        time.sleep(0.2)


def _session(process: Path) -> int:
    try:
        return os.getsid(int(process.name))
    except ProcessLookupError:
        return 0  # it ended just now


def _command(process: Path) -> str:
    try:
        return (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
    except OSError:
        return ""  # it ended just now


def _serve(process: subprocess.Popen[bytes], pictures: Path, suite: str, out: Path, end: float) -> None:
    """Take the screenshots that are asked for until Blender ends."""
    wish = pictures / "SHOT"
    while process.poll() is None:
        if time.monotonic() > end:
            raise RuntimeError("Blender does not end.")
        if wish.exists() and (name := wish.read_text()):
            subprocess.run(_tool("shot", suite, [str(pictures / name)]), env=_environment(out), check=True)
            wish.unlink()
        time.sleep(0.1)


def _tool(verb: str, suite: str, command: list[str]) -> list[str]:
    return [
        "bash",
        os.environ["MOCAP_REAL_BLENDER"],
        verb,
        "--suite",
        suite,
        "--display",
        _DISPLAY,
        "--",
        *command,
    ]


SUITES = ("trixie", "sid")
_DISPLAY = str(100 + os.getpid() % 500)  # A screen of its own, as several runs may go on at a time.


def _environment(out: Path) -> dict[str, str]:
    return {**os.environ, "WORK": str(out), "BLENDER_USER_RESOURCES": f"{_INSIDE}/user"}


def _is_error(line: str) -> bool:
    return any(word in line for word in ("Traceback", "Error", "Exception")) and not any(w in line for w in _HARMLESS)


def main() -> int:
    """Play the script and say how it went."""
    parser = argparse.ArgumentParser(prog="python -m tests.gui", description=__doc__)
    parser.add_argument("--suite", choices=SUITES, default="trixie", help="which Blender")
    parser.add_argument("--script", default="workflow.py")
    parser.add_argument("--out", type=Path, default=Path("dist/gui_run"), help="folder of the run; it is emptied")
    parser.add_argument("--renew", action="store_true", help="take the tutorials' pictures anew, in Blender 5.2")
    parser.add_argument("--clip", action="store_true", help="make the README's animation, in Blender 5.2")
    options = parser.parse_args()
    if options.clip:
        options.suite, options.script = "sid", "clip.py"
    if options.renew:
        options.suite, options.script = "sid", "pictures.py"
    if lack := missing():
        print(f"skipped: {lack}")
        return 0
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that Blender and its screen end too
    record = run(options.suite, options.out.resolve(), options.script)
    print(json.dumps(record, indent=1))
    if options.clip and not record.get("failure", "Blender ended early"):
        print(write_animation(options.out / "pictures", CLIP))
    if options.renew and not record.get("failure", "Blender ended early"):
        for path in renew(options.out / "pictures", IMAGES):
            print(path, path.stat().st_size)
    return 1 if record.get("failure", "Blender ended early") or record["console"] or record["left_behind"] else 0


if __name__ == "__main__":
    sys.exit(main())
