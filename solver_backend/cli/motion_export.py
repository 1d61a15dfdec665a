"""Run ``motion export``: write joint angles, gait, and files for OpenSim."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from solver_backend.biomechanics.gait import CYCLE_POINTS, MEASURES, SIDES, UNITS, Gait, find_gait, mean_cycles
from solver_backend.biomechanics.joint_angles import Angles, isb_angles
from solver_backend.biomechanics.open_sim import (
    coordinates,
    kinematics_setup,
    mot_text,
    scale_setup,
    virtual_markers,
)
from solver_backend.biomechanics.segments import posed_segments, turn_covariances, without_fingers
from solver_backend.body.files.choices import load_chosen_body
from solver_backend.cli.motion_reading import any_motion
from solver_backend.cli.outcome import Outcome, rows
from solver_backend.exchange.errors import FileMissing
from solver_backend.exchange.outputs import atomic_files
from solver_backend.exchange.progress import Progress
from solver_backend.io.markers.c3d import PER_PARAMETER, write_c3d
from solver_backend.io.markers.camera_systems import trc_text
from solver_backend.types import FLAG_UNSEEN

MODEL = "Rajagopal2016.osim"  # Generic OpenSim model that the Scale Tool scales.
ENDINGS = (".mot", "_markers.trc", "_scale.xml", "_ik.xml", "_angles.csv")
GAIT_ENDINGS = ("_events.c3d", "_gait.csv", "_cycles.csv")  # Endings of further files for a person who walks or runs.
TREADMILL = "length and speed are unknown on a treadmill"
OLD = "This motion has no steps. {} in the folder is from an earlier export."
TOO_MANY = f"The C3D file has the first {PER_PARAMETER} of {{}} events. The gait table has all of them."


def export_motion(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a motion's joint angles, gait tables and OpenSim files."""
    if args.model is not None and not args.model.is_file():
        raise FileMissing("The OpenSim model does not exist.", where=str(args.model), hint="Choose an .osim file.")
    body = load_chosen_body(args.body)
    motion = without_fingers(any_motion(args.motion, args.body), body)
    name, folder, frames = args.motion.stem, Path(args.out), motion.num_frames
    paths = {ending: folder / f"{name}{ending}" for ending in ENDINGS + GAIT_ENDINGS}
    with atomic_files(list(paths.values()), overwrite=args.overwrite) as unfinished:
        places = dict(zip(paths, unfinished, strict=True))
        progress("Posing the segments", 0, 2)
        posed = posed_segments(motion, body)
        angles, cloud = isb_angles(posed, turn_covariances(motion)), virtual_markers(motion, body, posed)
        gait = find_gait(posed, cloud, motion.flags)
        progress("Writing the files", 1, 2)
        markers, model = paths["_markers.trc"].name, MODEL if args.model is None else str(args.model.resolve())
        texts = {
            ".mot": mot_text(name, coordinates(posed), motion.fps),
            "_markers.trc": trc_text(markers, cloud),
            "_scale.xml": scale_setup(name, model, markers, frames, motion.fps, body.stature_of(motion.betas)),
            "_ik.xml": kinematics_setup(name, markers, cloud.labels or (), frames, motion.fps),
            "_angles.csv": angles_text(angles, motion.fps, motion.flags),
        }
        events = gait.events()
        if events:
            texts["_gait.csv"] = gait_text(gait)
            texts["_cycles.csv"] = cycles_text(mean_cycles(angles, gait, motion.fps))
            write_c3d(places["_events.c3d"], cloud, events=events)
        for ending, text in texts.items():
            places[ending].write_text(text, encoding="utf-8", newline="\n")
    progress("Writing the files", 2, 2)
    written = {ending: str(path) for ending, path in paths.items() if events or ending in ENDINGS}
    old = [path.name for ending, path in paths.items() if str(path) not in written.values() and path.exists()]
    lines = [
        f"Motion {name}: {frames} frames at {motion.fps:g} Hz",
        *rows("flexion", *_ranges(angles)),
        *rows("gait", *gait_lines(gait)),
        *rows("note", *([TOO_MANY.format(len(events))] if len(events) > PER_PARAMETER else [])),
        *rows("note", *([OLD.format(", ".join(old))] if old else [])),
        *rows(
            "ground", *([f"rotated by {posed.turned_deg} degrees about the vertical axis"] if posed.turned_deg else [])
        ),
        *rows("written", *written.values()),
    ]
    data = {"frames": frames, "fps": motion.fps, "files": list(written.values())}
    data |= {"strides": len(gait.strides), "turned_deg": posed.turned_deg}
    return Outcome("\n".join(lines), data)


def _ranges(angles: Angles) -> list[str]:
    found = []
    for joint, name in (("hip", "flexion"), ("knee", "flexion"), ("ankle", "dorsiflexion")):
        left, right = (angles.column(f"{side}_{joint}_{name}") for side in ("left", "right"))
        spans = [f"{side} {curve.min():.0f} to {curve.max():.0f}" for side, curve in (("left", left), ("right", right))]
        found.append(f"{joint}: {', '.join(spans)} degrees")
    return found


def angles_text(angles: Angles, fps: float, flags: np.ndarray | None) -> str:
    """Return joint angles and standard deviations as a CSV table, one row per frame.

    The column ``interpolated`` is 1 in frames without measurements (``FLAG_UNSEEN`` in the motion's (F,) flags).
    """
    unseen = np.zeros(len(angles.degrees)) if flags is None else (flags & FLAG_UNSEEN > 0).astype(float)
    names = [f"{name}{column}" for name in angles.names for column in ("_deg", "_sd_deg")]
    unknown = np.full(angles.degrees.shape, np.nan)
    values = np.stack([angles.degrees, unknown if angles.deviations is None else angles.deviations], axis=-1)
    values = np.column_stack([np.arange(len(values)) / fps, unseen, values.reshape(len(values), -1)])
    return _table(["time_s", "interpolated", *names], values)


def _table(names: list[str], values: np.ndarray) -> str:
    lines = [",".join(_cell(v) for v in row) for row in values]
    return "\n".join([",".join(names), *lines]) + "\n"


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.4f}"


def gait_lines(gait: Gait) -> list[str]:
    """Describe the mean and standard deviation of each stride measure, one line per side."""
    lines = []
    for side in SIDES:
        strides = [stride for stride in gait.strides if stride.side == side]
        known = {word: [getattr(stride, key) for stride in strides] for key, word in MEASURES.items()}
        known = {word: [value for value in v if np.isfinite(value)] for word, v in known.items()}
        texts = [
            f"{word} {np.mean(v):.2f}" + (f" ± {np.std(v, ddof=1):.2f}" if len(v) > 1 else "") + f" {UNITS[word]}"
            for word, v in known.items()
            if v
        ]
        texts += [TREADMILL] if any(np.isnan(stride.length_m) for stride in strides) else []
        lines += [f"{side}, {len(strides)} strides: {', '.join(texts)}"] if texts else []
    return lines or ([] if not gait.events() else ["there are steps, but no complete stride"])


def gait_text(gait: Gait) -> str:
    """Return gait events and strides as a CSV table, with one row per event and one row per stride."""
    events = [f"event,{side.lower()},{name},{time:.4f},,,,,," for time, side, name in gait.events()]
    strides = [
        f"stride,{s.side},,{s.strike_s:.4f},{s.off_s:.4f}," + ",".join(_cell(getattr(s, key)) for key in MEASURES)
        for s in gait.strides
    ]
    head = ",".join(["kind", "side", "event", "start_s", "foot_off_s", *MEASURES])
    return "\n".join([head, *events, *strides]) + "\n"


def cycles_text(cycles: dict[str, np.ndarray]) -> str:
    """Return mean joint angles of a gait cycle as a CSV table, one row per percent of the cycle."""
    names = [f"{name}{column}" for name in cycles for column in ("_mean_deg", "_sd_deg")]
    values = np.concatenate([np.linspace(0, 100, CYCLE_POINTS)[:, None], *cycles.values()], axis=1)
    return _table(["percent", *names], values)
