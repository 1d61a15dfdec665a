"""All methods of the comparison by name, and variants with changed settings."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from research.baselines import (
    DCT,
    DMMR,
    ETC,
    Baseline,
    BaselineResult,
    BundleMoCap,
    BundleMoCapPlusPlus,
    MuVS,
    TriangulatedButterworth,
)
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture
from tests.benchmarks.comparison.truth_prior import TruthPrior

FILTER, PUBLISHED, OURS = "triangulation + Butterworth", "BundleMoCap++", "ours"
EXACT_PRIOR = "ours, prior without error"
"""Our method with a prior that reproduces the take's true poses. The prior does not cause the remaining error."""
BASELINES: dict[str, type[Baseline]] = {
    FILTER: TriangulatedButterworth, "MuVS": MuVS, "DCT": DCT, "ETC": ETC, "DMMR": DMMR, "BundleMoCap": BundleMoCap,
    PUBLISHED: BundleMoCapPlusPlus,
}  # fmt: skip


@dataclass(frozen=True)
class Method:
    """A method with some changed settings."""

    kind: str  # A name of ``BASELINES``, ``OURS`` or ``EXACT_PRIOR``.
    changes: tuple[tuple[str, Any], ...] = ()  # Names and values of the changed settings.
    label: str = ""  # Name in tables. If empty, it is made from kind and changes.

    @classmethod
    def of(cls, kind: str, label: str = "", **changes: Any) -> Method:
        """Return the method with these settings changed."""
        return cls(kind, tuple(sorted(changes.items())), label)

    @property
    def name(self) -> str:
        """Name of the method in the tables."""
        return self.label or ", ".join([self.kind, *(f"{key} {value}" for key, value in self.changes)])

    @property
    def known(self) -> bool:
        """True if every changed setting exists."""
        return {key for key, _ in self.changes} <= {f.name for f in fields(self._settings)}

    @property
    def module(self) -> str:
        """Module that solves. Its imports determine whether an earlier result is still valid."""
        return "solver_backend.fitters.pipeline" if self._is_ours else BASELINES[self.kind].__module__

    def solver(self) -> Callable[[Capture], BaselineResult]:
        """Return the function that solves a capture."""
        if not self._is_ours:
            return BASELINES[self.kind](**dict(self.changes)).solve
        settings = SolveSettings(**dict(self.changes))
        if settings.backend != "numpy":
            importlib.import_module(settings.backend)  # imported before the time starts, like NumPy
        solve = importlib.import_module(self.module).solve

        def ours(capture: Capture) -> BaselineResult:
            prior = _exact_prior(capture) if self.kind == EXACT_PRIOR else None
            motion = solve(capture, settings, prior=prior).motion
            return BaselineResult(motion.keypoints3d, motion)

        return ours

    @property
    def _is_ours(self) -> bool:
        return self.kind in (OURS, EXACT_PRIOR)

    @property
    def _settings(self) -> type:
        return SolveSettings if self._is_ours else BASELINES[self.kind]


def _exact_prior(capture: Capture) -> TruthPrior:
    return TruthPrior(load_sposer(), exp_so3(capture.truth["body_pose"][:, :63].reshape(-1, 21, 3)))


def copied() -> list[Method]:
    """Return the published method as in its text: keys start as copies of the previous key, with either optimiser."""
    return [
        Method.of(PUBLISHED, "BundleMoCap++, keys copied", start="previous"),
        Method.of(PUBLISHED, "BundleMoCap++, keys copied, L-BFGS", start="previous", optimiser="lbfgs"),
    ]


_SLIDING = (
    ("SLERP, 10 frames", {"interpolation": 1, "window": 10}),
    ("SIDER-2, 20 frames", {}),
    ("SIDER-3, 30 frames", {"interpolation": 3, "window": 30}),
    ("SIDER-4, 40 frames", {"interpolation": 4, "window": 40}),
    ("SIDER-2, root on SE(3)", {"root_curve": "screw"}),
    ("SIDER-3, root on SE(3)", {"interpolation": 3, "window": 30, "root_curve": "screw"}),
)
"""Curves of ``solve --method sliding``, by Gauss-Newton steps with a shape and noise that are estimated before."""


def curves() -> list[Method]:
    """Return the published method and our sliding method, with SIDER-n and the root on a screw of SE(3)."""
    plain = {"optimiser": "lbfgs"}
    return [
        Method.of(PUBLISHED, "SLERP, a key every 20 frames", interpolation=1, **plain),
        Method.of(PUBLISHED, "SLERP, a key every 10 frames", interpolation=1, window=10, **plain),
        Method.of(PUBLISHED, "SIDER-2, 10 frames", window=10, **plain),
        Method.of(PUBLISHED, "SIDER-2, 20 frames", **plain),
        Method.of(PUBLISHED, "SIDER-3, 30 frames", interpolation=3, window=30, **plain),
        Method.of(PUBLISHED, "SIDER-4, 40 frames", interpolation=4, window=40, **plain),
        Method.of(PUBLISHED, "SIDER-2, root from key to key by SLERP", root="slerp", **plain),
        Method.of(PUBLISHED, "SIDER-2, root on SE(3)", root="se3", **plain),
        *(Method.of(OURS, f"ours, sliding, {label}", method="sliding", **changes) for label, changes in _SLIDING),
    ]


def compared() -> list[Method]:
    """Return the methods of the main table."""
    return [
        *map(Method, BASELINES),
        *copied(),
        Method.of(OURS, "ours, sliding", method="sliding"),
        Method.of(OURS, "ours, global"),
        Method(EXACT_PRIOR),
    ]


def ablations() -> list[Method]:
    """Return our method, and variants with each switch inverted or other settings replaced."""
    switches = [f for f in fields(SolveSettings) if isinstance(f.default, bool)]
    turned = [
        Method.of(OURS, f"{'without' if f.default else 'with'} {f.name.replace('_', ' ')}", **{f.name: not f.default})
        for f in switches
    ]
    others = [
        Method.of(OURS, "sliding windows alone", method="sliding"),
        Method.of(OURS, "frame by frame", method="frame"),
        Method.of(OURS, "robust scale 30 (nearly least squares)", robust_scale=30.0),
        Method.of(OURS, "keys twice as far apart", refine_window=20),
    ]
    return [Method.of(OURS, "ours, global"), *turned, *(method for method in others if method.known)]
