"""Fixtures and settings every test shares."""

from __future__ import annotations

import os

# Small matrices gain nothing from BLAS threads and suites run side by side; set before NumPy loads its BLAS.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from importlib.util import find_spec  # noqa: E402
from pathlib import Path  # noqa: E402

import hypothesis  # noqa: E402
import pytest  # noqa: E402

if find_spec("jaxtyping") and find_spec("beartype"):
    from jaxtyping import install_import_hook

    # Before anything imports the solver: its annotated shapes are checked in every call that a test makes.
    install_import_hook(
        [f"solver_backend.{name}" for name in ("body", "cameras", "geometry", "metrics", "priors", "types")],
        "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))",
    )

hypothesis.settings.register_profile(
    "mocap",
    deadline=None,
    max_examples=50,
    derandomize=True,
    database=None,
    suppress_health_check=[hypothesis.HealthCheck.function_scoped_fixture, hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("mocap")


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers."""
    config.addinivalue_line("markers", "slow: takes more than a few seconds")
    config.addinivalue_line("markers", "shared: needs the recordings kept beside the repository")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of recordings kept beside the repository; skip where it is missing."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("MOCAP_SHARED_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder.name}: set MOCAP_SHARED_DATA to their folder")
    return folder
