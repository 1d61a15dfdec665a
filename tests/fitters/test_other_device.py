"""Every method runs with its arrays on another device than the CPU, and finds the same: no array is made elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import pipeline
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import DEMO_TAKE, demo_capture
from solver_backend.types import Capture
from tests.support.short_solves import cut

torch = pytest.importorskip("torch")
from tests.support.other_device import DEVICE, another_device  # noqa: E402


def _markers() -> Capture:
    capture = load_capture(DEMO_TAKE)
    assert capture.markers is not None
    part = slice(60, 70)
    cloud = replace(
        capture.markers, positions=capture.markers.positions[part],
        residual=None if capture.markers.residual is None else capture.markers.residual[part],
    )  # fmt: skip
    return replace(capture, markers=cloud)


TAKES = {"views": lambda: cut(demo_capture(10), 0, 10), "markers": _markers}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("take", "method"),
    [
        ("views", "global"),
        ("views", "sliding"),
        ("views", "bundlemocap++"),
        ("views", "frame"),
        ("markers", "global"),
        ("markers", "noise-aware"),
    ],
)
def test_a_solve_elsewhere_finds_the_same(take: str, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    capture: Capture = TAKES[take]()
    settings = SolveSettings(backend="torch", method=method, iterations=4)
    here = pipeline.solve(capture, settings).motion
    monkeypatch.setattr(pipeline, "make_origin", lambda _: torch.zeros(1, dtype=torch.float64, device=DEVICE))
    with another_device():
        there = pipeline.solve(capture, settings).motion
    np.testing.assert_allclose(there.joints, here.joints, atol=1e-6)
    np.testing.assert_allclose(there.transl, here.transl, atol=1e-6)


@pytest.mark.slow
def test_the_stand_in_refuses_what_a_device_refuses() -> None:
    with another_device():
        there, here = torch.zeros(3, device=DEVICE), torch.ones(3)
        assert there.device.type == DEVICE and (there + 1.0).device.type == DEVICE
        assert float((there + torch.tensor(2.0))[1]) == 2.0 and there.cpu().device.type == "cpu"
        with pytest.raises(RuntimeError, match="two devices"):
            _ = there + here
        with pytest.raises(RuntimeError, match="filled from the CPU"):
            there[torch.tensor([0, 1])] = here[:2]
        with pytest.raises(RuntimeError, match="indexed"):
            _ = here[torch.zeros(2, dtype=torch.int64, device=DEVICE)]
        with pytest.raises(RuntimeError):
            there.numpy()
