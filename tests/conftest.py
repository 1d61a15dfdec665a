"""Fixtures and settings every test shares."""

from __future__ import annotations

import gc
import os

# Small matrices gain nothing from BLAS threads and suites run side by side; set before NumPy loads its BLAS.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# The solver gives torch every core. Threads that wait by turning in circles keep the other worker's core busy.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from collections.abc import Generator  # noqa: E402
from importlib.util import find_spec  # noqa: E402
from pathlib import Path  # noqa: E402

import hypothesis  # noqa: E402
import hypothesis.internal.conjecture.providers  # noqa: E402
import pytest  # noqa: E402

CHECKED = [f"solver_backend.{name}" for name in ("body", "cameras", "geometry", "metrics", "priors")]
"""Packages whose annotated shapes are checked; the types check their own fields."""
if HAS_JAXTYPING := bool(find_spec("jaxtyping") and find_spec("beartype")):
    import jaxtyping

    from tests.support import annotation_checks

    annotation_checks.install(CHECKED)  # before anything imports the solver

from solver_backend.geometry import parallel  # noqa: E402
from tests.support.collecting import in_turn  # noqa: E402
from tests.support.recordings import recordings_folder  # noqa: E402
from tests.support.slow_tests import is_left_out, left_out  # noqa: E402

if "PYTEST_XDIST_WORKER" in os.environ:
    parallel.MAX_THREADS = 1  # a worker has a core: threads would only take turns on it

gc.set_threshold(10_000, 10, 100)
"""Half a million objects of the tests stay: looking through them seldom saves 4 % of the run."""

# Hypothesis parses each module of the program for constants to draw. The examples then depend on what was imported.
hypothesis.internal.conjecture.providers.is_local_module_file = lambda path: False

for _name, _examples in (("mocap", 25), ("mocap --all", 50)):  # Examples of each property. By hand.
    hypothesis.settings.register_profile(
        _name,
        deadline=None,
        max_examples=_examples,
        derandomize=True,
        database=None,
        suppress_health_check=[hypothesis.HealthCheck.function_scoped_fixture, hypothesis.HealthCheck.too_slow],
    )
hypothesis.settings.load_profile("mocap")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option of the whole suite."""
    parser.addoption("--all", action="store_true", help="run what is marked slow, too; a named file runs whole")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Let workers that have nothing compiled yet collect one after the other."""
    with in_turn():
        return (yield)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no test of what no user runs, where it is not asked for."""
    return is_left_out(config, collection_path) or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what no user runs and what is slow, where it is not asked for."""
    if slow := set(left_out(config, items)):
        config.hook.pytest_deselected(items=list(slow))
        items[:] = [item for item in items if item not in slow]


def pytest_collection_finish() -> None:
    """Leave the tests themselves out of the search for garbage: they stay until the end."""
    gc.freeze()


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers, and draw more examples of properties in the whole suite."""
    if config.getoption("--all"):
        hypothesis.settings.load_profile("mocap --all")
    config.addinivalue_line("markers", "slow: takes seconds and guards what seldom breaks: --all runs it")
    config.addinivalue_line("markers", "shared: needs the recordings kept beside the repository")
    config.addinivalue_line("markers", "misshapen: passes what the annotations forbid, to see the library refuse it")


@pytest.fixture(autouse=True)
def _annotations_are_checked(request: pytest.FixtureRequest) -> None:
    """Check shapes and types, but where a test is about the library's own checks."""
    if HAS_JAXTYPING:
        annotation_checks.begin_test()
        jaxtyping.config.update("jaxtyping_disable", request.node.get_closest_marker("misshapen") is not None)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of recordings kept beside the repository; skip where it is missing."""
    folder = recordings_folder()
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder.name}: set MOCAP_SHARED_DATA to their folder")
    return folder
