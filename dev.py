#!/usr/bin/env python3
"""Create the project's environment and run its verbs. Only Python 3.11 is required.

``python3 dev.py test`` runs every check and the main tests. ``test --all`` runs every test.
``--python 3.13 test`` runs the tests with Blender 5's module.
The environment is ``.venv`` (or ``.venv-3.13``). The first call creates it, and a change of pyproject.toml renews it.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VERSION = os.environ.get("MOCAP_DEV_PYTHON", "3.11")
WANTED = tuple(int(part) for part in VERSION.split(".") if part.isdigit())
VENV = ROOT / (".venv" if VERSION == "3.11" else f".venv-{VERSION}")
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")
LOCK = ROOT / "requirements-ci.lock"
STAMP = VENV / "manifold_mocap.stamp"
IS_WANTED = f"import sys; sys.exit(sys.version_info[:2] != {WANTED})"
EXTRAS = ("torch", "bpy", "capture", "oak", "train", "scale", "dev")
LIBRARIES = "libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libgl1 libegl1 libgl1-mesa-dri"
"""Debian and Ubuntu packages that the Blender module loads. The last two are for rendering."""
SITE = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
PROBE = "import bpy, ctypes, sys; sys.platform == 'linux' and ctypes.CDLL('libEGL.so.1')"


class Failed(Exception):
    """Error of a failed step, with a message and a hint."""

    def __init__(self, message: str, hint: str = "", code: int = 1) -> None:
        self.message, self.hint, self.code = message, hint, code


def main(argv: list[str] | None = None) -> int:
    """Run one verb and return its exit code."""
    # They need Python 3.11, which an older Python must be able to look for.
    from solver_backend.exchange.errors import CommandLineInvalid
    from supply.dev_verbs import program

    argv = sys.argv[1:] if argv is None else argv
    try:
        if argv[:1] and argv[0] in ("test", "bench"):  # every argument is passed on, such as --help
            return run_verb(argparse.Namespace(verb=argv[0]), argv[1:])
        return run_verb(program(__doc__ or "").parse(argv), [])
    except CommandLineInvalid as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    except Failed as error:
        print(f"\n✗ {error.message}" + (f"\n  {error.hint}" if error.hint else ""), file=sys.stderr, flush=True)
        return error.code
    except KeyboardInterrupt:
        print("\n✗ Cancelled.", file=sys.stderr)
        return 130


def run_verb(args: argparse.Namespace, rest: list[str]) -> int:
    """Create the environment if it is missing, then run the verb."""
    if args.verb == "demo":
        return demo(args)
    if args.verb == "detectors":
        return call([sys.executable, "-m", "supply.detectors"])
    if args.verb == "build":  # needs the standard library alone
        return call([sys.executable, "build_addon.py"])
    set_up()
    made = {
        "test": ["-m", "supply.checks", "test", *rest],
        "lint": ["-m", "supply.checks", "lint", *(["--fix"] if getattr(args, "fix", False) else [])],
        "bench": ["-m", "tests.benchmarks", *rest],
    }
    if args.verb in made:
        return call([str(PYTHON), *made[args.verb]])
    if args.verb == "docs":
        return call([str(PYTHON), "-m", "supply.pages"]) or call(
            [str(PYTHON), "-m", "mkdocs", "build", "--quiet"], env=SITE
        )
    print(f"The environment is ready: {PYTHON}")
    return 0


def set_up() -> None:
    """Create ``.venv`` and install everything, unless it is up to date with pyproject.toml."""
    mark = fingerprint()
    if PYTHON.exists() and STAMP.exists() and STAMP.read_text(encoding="utf-8") == mark:
        return
    print(f"Setting up {VENV.name} (once, about 1 GB of downloads)", flush=True)
    STAMP.unlink(missing_ok=True)
    make_venv()
    install()
    check_blender()
    STAMP.write_text(mark, encoding="utf-8")


def fingerprint() -> str:
    """Return a hash of everything that determines the environment's contents."""
    parts = ((ROOT / "pyproject.toml").read_bytes(), repr((EXTRAS, sys.version, str(ROOT))).encode())
    return hashlib.sha256(b"\0".join(parts)).hexdigest()


def make_venv() -> None:
    """Create the virtual environment, or replace one without pip or with another Python version."""
    if PYTHON.exists() and call([str(PYTHON), "-c", f"import pip; {IS_WANTED}"], quiet=True) == 0:
        return
    if call([sys.executable, "-m", "venv", "--clear", str(VENV)]) != 0:
        hint = "On Debian and Ubuntu, run: apt-get install python3.11-venv. Otherwise check free space and permissions."
        raise Failed("The virtual environment could not be created.", hint)


def install() -> None:
    """Install the project with all extras in one step, so that no later step replaces NumPy."""
    project = f"{ROOT}[{','.join(EXTRAS)}]"
    env = {name: value for name, value in os.environ.items() if name != "UV_SYSTEM_PYTHON"}
    for uv_name, pip_name in (("UV_FIND_LINKS", "PIP_FIND_LINKS"), ("UV_DEFAULT_INDEX", "PIP_INDEX_URL")):
        if env.get(pip_name) and not env.get(uv_name):  # uv does not read pip's settings
            env[uv_name] = env[pip_name]
    # A path is enough for our packages. Without this setting, a hook of setuptools runs at every start of Python.
    editable = ["--config-settings", "editable_mode=compat", "--editable", project]
    pip = [str(PYTHON), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    uv = [str(PYTHON), "-m", "uv", "pip", "install", "--python", str(PYTHON)]
    locked = [["--constraint", str(LOCK)]] if os.environ.get("CI") and LOCK.is_file() else []
    if call([*pip, "uv>=0.5"]) == 0:
        for bound in (*locked, []):  # exact versions by hash first; this machine may have other archives
            if call([*uv, *bound, *editable], env=env) == 0:
                return
    print("uv is not available or failed. Trying pip, which is slower.", flush=True)
    # A setuptools that has dropped the setting needs the last attempt.
    if call([*pip, *editable], env=env) != 0 and call([*pip, "--editable", project], env=env) != 0:
        hint = "Check the network and the free space (3 GB), then run the command again. It keeps installed packages."
        raise Failed("The packages could not be installed. The lines above name the package that failed.", hint)


def check_blender() -> None:
    """Check that the Blender module loads. Install missing Debian packages if possible."""
    apt = shutil.which("apt-get")
    missing = blender_error() or (apt and not any(Path("/usr/lib").glob("*/dri/*_dri.so")) and "no software renderer")
    if not missing:
        return
    command = "apt-get install -y --no-install-recommends " + LIBRARIES
    if apt and hasattr(os, "geteuid") and os.geteuid() == 0:
        print(f"Blender needs system libraries ({missing}). Installing them.", flush=True)
        env = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        quiet = ["-q", "-o", "Dpkg::Use-Pty=0"]
        call([apt, "update", *quiet], env=env, quiet=True)
        if call([*command.split(), *quiet], env=env, quiet=True) == 0 and not blender_error():
            return
    hint = f"It needs system libraries. Run as root: {command}" if apt else f"Install what Debian calls {LIBRARIES}."
    raise Failed(f"Blender's Python module does not load: {blender_error() or missing}", hint)


def blender_error() -> str:
    """Import the Blender module and return the last line of its error, or ''."""
    done = subprocess.run([str(PYTHON), "-c", PROBE], capture_output=True, text=True, cwd=ROOT)
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["it crashed"])[-1]


def demo(args: argparse.Namespace) -> int:
    """Solve a capture and bake it into a new folder."""
    out = demo_folder(args)
    capture, motion = out / "capture.npz", out / "motion.npz"
    backend = [str(PYTHON), "-m", "solver_backend"]
    if args.capture is None:
        read = [*backend, "dataset demo", "--out", str(capture), *(["--markers"] if args.markers else [])]
    else:
        from supply.dev_verbs import READING

        options = {row.options[-1]: getattr(args, row.name) for row in READING}
        given = [f"{name}={value}" for name, value in options.items() if value is not None] + ["--trim"] * args.trim
        read = [*backend, "convert", str(args.capture.resolve()), "--out", str(capture), *given]
    solve = [*backend, "solve", str(capture), "--out", str(motion), "--report", str(out / "report.html")]
    solve += ["--method", args.method, "--backend", args.backend]
    bake = [str(PYTHON), "-m", "blender_addon", "bake", str(motion), "--capture", str(capture), "--out", str(out)]
    bake += [] if args.capture is None else ["--footage-from", str(args.capture.resolve())]
    stages = [("Capture", read), ("Solve", solve), ("Bake in Blender", bake)]
    if args.capture is None and not args.markers:
        stages.insert(2, ("Compare with the truth", [*backend, "evaluate", str(capture), str(motion)]))
    started = time.monotonic()
    stage("Environment", set_up, 1, len(stages) + 1)
    for number, (name, command) in enumerate(stages, start=2):
        stage(name, lambda c=command: require(c, out), number, len(stages) + 1)
    print(f"\nDone in {time.monotonic() - started:.1f} s: {out}")
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        print(f"  {path.stat().st_size / 1e6:8.2f} MB  {path.relative_to(out)}")
    return 0


def demo_folder(args: argparse.Namespace) -> Path:
    """Return the folder for the results. Check that it is empty and writable."""
    if args.capture is not None and not args.capture.exists():
        raise Failed(f"There is no capture at {args.capture}.", "Check the path.", 2)
    name = f"embedded{'_markers' * args.markers}" if args.capture is None else args.capture.resolve().stem
    names = (Path.cwd() / (f"demo_{name}" + (f"_{n}" if n > 1 else "")) for n in range(1, 10_000))
    out = (args.out or next(path for path in names if not path.exists())).resolve()
    if out.exists() and (not out.is_dir() or any(not p.name.startswith((".probe", ".part-")) for p in out.iterdir())):
        raise Failed(f"{out} exists and is not empty.", "Choose another --out, or empty the folder.", 2)
    try:
        out.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=out).close()
    except OSError as error:
        raise Failed(f"{out} is not writable: {error.strerror}.", "Choose another --out.", 2) from error
    return out


def stage(name: str, work: Callable[[], None], number: int, count: int) -> None:
    """Run one stage of the demo, and print its duration."""
    print(f"\n[{number}/{count}] {name}", flush=True)
    start = time.monotonic()
    work()
    print(f"      {time.monotonic() - start:.1f} s", flush=True)


def require(command: list[str], out: Path) -> None:
    """Run a command, and raise ``Failed`` if it fails. Remove the output folder if it is empty."""
    if (code := call(command)) == 0:
        return
    if not (kept := any(out.iterdir())):
        out.rmdir()
    raise Failed(f"This stage failed (exit code {code}).", f"Finished files are in {out}." if kept else "", code)


def call(command: list[str], *, quiet: bool = False, env: dict[str, str] | None = None) -> int:
    """Run a command in the repository's root, and return its exit code."""
    try:
        out = subprocess.DEVNULL if quiet else None
        process = subprocess.Popen(command, cwd=ROOT, env=env, stdout=out, stderr=out)
    except FileNotFoundError:
        return 127
    try:
        return process.wait()
    except KeyboardInterrupt:  # the child got it too and tidies up
        try:
            process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
        raise


def with_wanted_python() -> int:
    """Run ``main`` in the required Python version, either in this process or in a new one."""
    if "--python" in sys.argv[:-1]:
        place = sys.argv.index("--python")
        os.environ["MOCAP_DEV_PYTHON"] = sys.argv[place + 1]
        return call([sys.executable, str(Path(__file__).resolve()), *sys.argv[1:place], *sys.argv[place + 2 :]])
    if sys.version_info[:2] == WANTED:
        return main()
    version = ".".join(map(str, WANTED))
    for command in ([f"python{version}"], ["py", f"-{version}"], [str(PYTHON)]):
        if call([*command, "-c", IS_WANTED], quiet=True) == 0:
            return call([*command, str(Path(__file__).resolve()), *sys.argv[1:]])
    missing = (
        f"✗ This is Python {sys.version.split()[0]}. Blender's module needs Python {version}, which was not found."
    )
    hint = f"Install Python {version} (python.org, pyenv or your system's packages), then run: python{version} dev.py …"
    print(f"{missing}\n  {hint}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(with_wanted_python())
