"""Label real takes without names, with 0.3 cuts per track second and shuffled columns.

The figures are the percentages of points with their name and with wrong names (other points count as unknown), also
with 5 markers missing and 3 ghosts, and the percentage that the network labels in single frames without time. Others
are the joint distances between a solve from found labels and a solve from true labels, the same for the network's own
joints without a solve, and the time of the network in NumPy and of the live loop.

Takes are CMU 02_01 and 135_02 (its first 20 s, every second frame), clips of UI-PRMD's held-out subjects 7 and 8, the
nimble takes' markers that the superset has, and the unlabelled prone and kneeling take. Constants of the labelling were
chosen on other takes, see docs/research-log/landmarks.md. The squat take's MT1 and MT5 are exchanged (MT5 is inside the
foot), which is corrected first. Our own body wears the IOR set. Everything uses one process and thread.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.fitters import solve
from solver_backend.fitters.recipes.live import LiveFit, fit_average_person
from solver_backend.io.markers.read import read_markers
from solver_backend.labelling.label_take import LabelledTake, label_take
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.labelling.point_network import PointNetwork, load_network
from solver_backend.live.frames import replayed
from solver_backend.live.session import LiveSession, LiveStatistics
from solver_backend.synthesis.embedded.demo import record_markers
from solver_backend.types import Capture, MarkerCloud
from tests.benchmarks.marker_takes.takes import cmu, folder, part, ui_prmd
from tests.benchmarks.metric import Metric
from tests.support.unlabelled_takes import UnlabelledTake, in_the_superset, score, stripped
from tests.support.worn_markers import worn_markers

IOR_FRAMES = 300  # Frames of the IOR set, at 60 Hz.
_UI_PRMD = ("m01_s07_e02", "m06_s07_e05", "m03_s08_e05", "m08_s08_e02")


def takes() -> dict[str, MarkerCloud]:
    """Return the takes by name."""
    found = {"cmu_02_01": cmu("02_01"), "cmu_135_02": _every_second(cmu("135_02", slice(0, 2400)))}
    found |= {clip: ui_prmd(folder() / "ui_prmd" / f"{clip}.npz") for clip in _UI_PRMD}
    nimble = folder() / "nimble"
    for name, path in (("run0350cms", nimble / "Sprinter" / "run0350cms.trc"), ("squat", nimble / "c3d" / "squat.c3d")):
        found[name] = part(read_markers(path).cloud, slice(0, 800))
    squat = found["squat"]
    swapped = {"MT1": "MT5", "MT5": "MT1"}
    labels = tuple(label[:-3] + swapped.get(label[-3:], label[-3:]) for label in squat.labels or ())
    found["squat"] = replace(squat, labels=labels)
    return found


def _every_second(cloud: MarkerCloud) -> MarkerCloud:
    return MarkerCloud(cloud.positions[::2], cloud.fps / 2, cloud.labels)


def run() -> list[Metric]:
    """Label, compare, solve and time."""
    network, metrics = load_network(), []
    totals: dict[str, list[tuple[float, float]]] = {"plain": [], "spoiled": []}
    for name, cloud in takes().items():
        for kind, options in (("plain", {}), ("spoiled", {"missing": 5, "ghosts": 3})):
            bare = stripped(cloud, 1, **options)
            labelled = label_take(bare.cloud, network, fit_average_person)
            found = score(labelled, bare.truth)
            metrics.append(Metric(f"{name}_{kind}_right", found.right, "%", "higher", abs_tol=0.5))
            metrics.append(Metric(f"{name}_{kind}_wrong", found.wrong, "%", abs_tol=0.5))
            if name not in ("run0350cms", "squat"):
                totals[kind].append((found.right, found.wrong))
            metrics.append(Metric(f"{name}_{kind}_one_frame", _one_frame(bare, labelled, network), "%", "higher"))
            if kind == "plain":
                joints, direct = _joints_mm(cloud, bare, labelled)
                metrics.append(Metric(f"{name}_joints", joints, "mm", abs_tol=1.0))
                metrics.append(Metric(f"{name}_direct_joints", direct, "mm", abs_tol=1.0))
    for kind, rows in totals.items():
        right, wrong = np.mean(rows, axis=0)
        metrics += [
            Metric(f"mean_{kind}_right", float(right), "%", "higher", abs_tol=0.3),
            Metric(f"mean_{kind}_wrong", float(wrong), "%", abs_tol=0.3),
        ]
    return [*metrics, *ior(network), *_prone(), *_speed()]


def ior(network: PointNetwork) -> list[Metric]:
    """Label the 40 markers of the IOR set on our own body. Seven of them are unknown to the network."""
    layouts = load_layouts()
    places = list(dict.fromkeys(place for label in layouts.label_sets["IOR"] if (place := layouts.place_of(label))))
    cloud = worn_markers(places, IOR_FRAMES).cloud
    inside = [i for i, place in enumerate(places) if place in MARKERS]
    others = [i for i in range(len(places)) if i not in inside]
    bare = stripped(cloud.columns(inside, tuple(places[i] for i in inside)), 1)
    points = np.concatenate([bare.cloud.positions, cloud.positions[:, others]], axis=1)
    truth = np.concatenate([bare.truth, np.full((IOR_FRAMES, len(others)), GHOST)], axis=1)
    found = score(label_take(MarkerCloud(points, cloud.fps), network, fit_average_person), truth)
    return [
        Metric("ior_right", found.right, "%", "higher", abs_tol=0.5),
        Metric("ior_wrong", found.wrong, "%", abs_tol=0.5),
    ]


def _one_frame(bare: UnlabelledTake, labelled: LabelledTake, network: PointNetwork) -> float:
    """Return the percentage of points that the network labels correctly in single frames."""
    points, truth = bare.cloud.positions[labelled.votes.frames], bare.truth[labelled.votes.frames]
    seen = np.isfinite(points).all(-1)
    told = [
        network(np.where(there[..., None], part, 0.0), there).scores.argmax(-1)
        for part, there in zip(np.array_split(points, 20), np.array_split(seen, 20), strict=True)
        if len(part)
    ]
    return 100.0 * float((np.concatenate(told) == truth)[seen].mean())


def _joints_mm(cloud: MarkerCloud, bare: UnlabelledTake, labelled: LabelledTake) -> tuple[float, float]:
    """Return the joint distances in mm from a solve with true labels, for found labels and for the network."""
    own, _ = in_the_superset(cloud)
    own, found = (solve(Capture("take", markers=c)).motion.joints for c in (own, labelled.cloud(bare.cloud)))
    return _mean_mm(found - own), _mean_mm(labelled.votes.landmarks[:, GHOST:] - own[labelled.votes.frames])


def _mean_mm(apart: np.ndarray) -> float:
    return 1e3 * float(np.linalg.norm(apart, axis=-1).mean())


def _prone() -> list[Metric]:
    """Label the prone and kneeling take without known labels, and return the percentage of labelled points."""
    path = Path(folder()) / "automarkerlabel" / "S01_Pronetokneel01_mksrem.c3d"
    cloud = read_markers(path).cloud
    labels = label_take(MarkerCloud(cloud.positions[::4], cloud.fps / 4), load_network(), fit_average_person)
    there = labels.labels[np.isfinite(labels.confidence)]
    return [Metric("prone_named", 100 * float(((there >= 0) & (there < GHOST)).mean()), "%", "higher", rel_tol=0.2)]


def _speed() -> list[Metric]:
    """Time one frame of 53 points in the network, and the live loop at full speed."""
    network, body = load_network(), load_body()
    cloud = record_markers(1436, seed=5, layout="MANIFOLD_53").cloud
    points = np.random.default_rng(0).normal(size=(1, 53, 3)) * (0.3, 0.2, 0.5)
    times = []
    for _ in range(300):
        start = time.perf_counter()
        network(points)
        times.append(time.perf_counter() - start)
    session, statistics = LiveSession(network, LiveFit(body), unit="m", up_axis="z"), LiveStatistics()
    start, used = time.perf_counter(), time.process_time()
    for line in session.run(replayed(cloud, paced=False)):
        statistics.add(line)
    frames = len(cloud.positions)
    rate, used = frames / (time.perf_counter() - start), (time.process_time() - used) / frames
    return [
        Metric("network_ms", 1e3 * float(np.median(times)), "ms", rel_tol=0.5),
        Metric("live_cpu_ms", 1e3 * used, "ms", rel_tol=0.5),
        Metric("live_fps", rate, "1/s", "higher", rel_tol=0.4),
        Metric("live_p99_ms", float(statistics.summary().get("latency_p99_ms", np.nan)), "ms", rel_tol=0.5),
    ]
