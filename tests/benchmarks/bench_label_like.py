"""Label real takes from another take of the same person and layout, without names and with 0.3 cuts per track second.

The figures are the percentages of points with their marker's name and with another name. Other points have no name.
Takes of five layouts, 300 frames at 60 Hz or less each, by their own labels and by labels without known places. Needs
the recordings (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from solver_backend.fitters.label_after import labelled_like, worn
from solver_backend.io.markers.read import read_markers
from solver_backend.types import Capture, MarkerCloud
from tests.benchmarks.marker_takes.takes import cmu, folder, ui_prmd
from tests.benchmarks.metric import Metric
from tests.support.takes_in_pieces import pieces, shares

PAIRS = {
    "run": ("nimble/Sprinter/run0350cms.trc", "nimble/Sprinter/run0700cms.trc"),
    "slower_run": ("nimble/Sprinter/run0700cms.trc", "nimble/Sprinter/run0350cms.trc"),
    "walk_after_squats": ("nimble/Subject4/MarkerData/squats1.trc", "nimble/Subject4/MarkerData/walking1.trc"),
    "opensim": ("opensim/walking2.c3d", "opensim/walking5.c3d"),
    "plug_in_gait_s07": ("ui_prmd/m01_s07_e02.npz", "ui_prmd/m05_s07_e02.npz"),
    "plug_in_gait_s08": ("ui_prmd/m03_s08_e05.npz", "ui_prmd/m08_s08_e02.npz"),
    "cmu_halves": ("cmu first half", "cmu second half"),
}
FRAMES, FPS = 300, 60


def run() -> list[Metric]:
    """Label the takes and print the figures."""
    found: dict[str, tuple[float, float]] = {}
    for name, (like, take) in PAIRS.items():
        one, two = _common(_cloud(like), _cloud(take))
        bare, truth = pieces(_short(two), 2)
        strange = replace(one, labels=tuple(f"X{k}q" for k in range(one.positions.shape[1])))
        for kind, reference in (("", one), ("_strange", strange)):
            _, named = labelled_like(Capture("take", markers=bare), Capture("like", markers=reference))
            right, wrong = found[name + kind] = shares(named.point_labels, truth)
            sys.stdout.write(f"  {name + kind:<26} right {right:6.2f} % wrong {wrong:5.2f} %\n")
            sys.stdout.flush()
    right, wrong = np.mean(list(found.values()), axis=0)
    rows = [*found.items(), ("mean", (float(right), float(wrong)))]
    return [
        metric
        for name, (right, wrong) in rows
        for metric in (
            Metric(f"{name}_right", right, "%", "higher", rel_tol=0.0, abs_tol=0.3),
            Metric(f"{name}_wrong", wrong, "%", rel_tol=0.0, abs_tol=0.3),
        )
    ]


def _cloud(name: str) -> MarkerCloud:
    if name.startswith("cmu"):
        return cmu("135_02", slice(0, 2000) if "first" in name else slice(2000, 4000))
    path = folder() / name
    return ui_prmd(path) if path.suffix == ".npz" else read_markers(path).cloud


def _short(cloud: MarkerCloud) -> MarkerCloud:
    step = max(1, int(cloud.fps // FPS))
    return replace(cloud, positions=cloud.positions[::step][:FRAMES], fps=cloud.fps / step, residual=None)


def _common(one: MarkerCloud, two: MarkerCloud) -> tuple[MarkerCloud, MarkerCloud]:
    """Return both takes with the markers that they share."""
    one = worn(one)
    labels = tuple(label for label in one.labels or () if label in (two.labels or ()))
    return (
        one.columns([(one.labels or ()).index(label) for label in labels], labels),
        two.columns([(two.labels or ()).index(label) for label in labels], labels),
    )
