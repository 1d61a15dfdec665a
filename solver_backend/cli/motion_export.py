"""``motion export``: joint angles, and files for OpenSim."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from solver_backend.biomechanics.joint_angles import Angles, isb_angles
from solver_backend.biomechanics.open_sim import (
    coordinates,
    kinematics_setup,
    mot_text,
    scale_setup,
    virtual_markers,
)
from solver_backend.biomechanics.segments import posed_segments
from solver_backend.body.files.choices import load_chosen_body
from solver_backend.cli.motion_reading import any_motion
from solver_backend.cli.outcome import Outcome, rows
from solver_backend.exchange.outputs import check_output, write_text
from solver_backend.exchange.progress import Progress
from solver_backend.io.markers.read import write_markers

MODEL = "Rajagopal2016.osim"  # Generic model that the setup of the Scale Tool names.
ENDINGS = (".mot", ".trc", "_scale.xml", "_ik.xml", "_angles.csv")


def export_motion(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a motion's joint angles, OpenSim coordinates, virtual markers and the setups of two of OpenSim's tools."""
    motion, body = any_motion(args.motion, args.body), load_chosen_body(args.body)
    name, folder, frames = args.motion.stem, Path(args.out), motion.num_frames
    paths = {ending: check_output(folder / f"{name}{ending}", overwrite=args.overwrite) for ending in ENDINGS}
    progress("Posing the segments", 0, 2)
    posed = posed_segments(motion, body)
    angles, cloud = isb_angles(posed), virtual_markers(motion, body, posed)
    progress("Writing the files", 1, 2)
    markers, model = paths[".trc"].name, str(args.model or MODEL)
    texts = {
        ".mot": mot_text(name, coordinates(posed), motion.fps),
        "_scale.xml": scale_setup(name, model, markers, frames, motion.fps, body.stature_of(motion.betas)),
        "_ik.xml": kinematics_setup(name, markers, cloud.labels or (), frames, motion.fps),
        "_angles.csv": angles_text(angles, motion.fps),
    }
    for ending, text in texts.items():
        write_text(paths[ending], text, overwrite=args.overwrite)
    write_markers(paths[".trc"], cloud, overwrite=args.overwrite)
    progress("Writing the files", 2, 2)
    written = {ending: str(path) for ending, path in paths.items()}
    lines = [
        f"Motion {name}: {frames} frames at {motion.fps:g} Hz",
        *rows("flexion", *_ranges(angles)),
        *rows("written", *written.values()),
    ]
    return Outcome("\n".join(lines), {"frames": frames, "fps": motion.fps, "files": list(written.values())})


def _ranges(angles: Angles) -> list[str]:
    found = []
    for joint, name in (("hip", "flexion"), ("knee", "flexion"), ("ankle", "dorsiflexion")):
        left, right = (angles.column(f"{side}_{joint}_{name}") for side in ("left", "right"))
        spans = [f"{side} {curve.min():.0f} to {curve.max():.0f}" for side, curve in (("left", left), ("right", right))]
        found.append(f"{joint}: {', '.join(spans)} degrees")
    return found


def angles_text(angles: Angles, fps: float) -> str:
    """Return a table of angles: a row for each frame, two columns for each angle. Unknown deviations are empty."""
    names = [f"{name}{column}" for name in angles.names for column in ("_deg", "_sd_deg")]
    unknown = np.full(angles.degrees.shape, np.nan)
    values = np.stack([angles.degrees, unknown if angles.deviations is None else angles.deviations], axis=-1)
    values = np.column_stack([np.arange(len(values)) / fps, values.reshape(len(values), -1)])
    rows_of_text = [",".join("" if np.isnan(v) else f"{v:.4f}" for v in row) for row in values]
    return "\n".join([",".join(["time_s", *names]), *rows_of_text]) + "\n"
