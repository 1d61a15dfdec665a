"""Verbs that read motions: ours, AMASS, clips of other programs, and recordings of gloves."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.props import Prop
from solver_backend.exchange.skeleton_file import SkeletonFile, write_skeleton
from solver_backend.io.motions.bvh import bvh_motion, bvh_skeleton, read_bvh
from solver_backend.io.native.motion_file import write_motion
from tests.fuzz.motion_targets import amass
from tests.fuzz.target import Target
from tests.fuzz.verbs.running import verb, verb_target
from tests.support.bvh_texts import known_motion, write_bvh
from tests.support.drawn_gloves import DrawnGloves, drawn_gloves, hands_bvh, manus_csv
from tests.support.moving_prop import RACKET, moving_prop
from tests.support.short_motion import short_motion

_FRAMES = 6
_NPZ, _BVH = {".npz": "npz"}, {".bvh": "text"}


def _motion(folder: Path) -> None:
    write_motion(folder / "motion.npz", short_motion(_FRAMES, 60.0))


def _with_prop(folder: Path) -> None:
    moved = moving_prop(RACKET, frames=_FRAMES, fps=60.0)
    seen = np.full(_FRAMES, 4)
    labels = tuple(f"racket{k}" for k in range(len(RACKET)))
    prop = Prop("racket", labels, RACKET, moved.rotvec, moved.transl, np.full((_FRAMES, 2), 1e-3), seen)
    write_motion(folder / "motion.npz", replace(short_motion(_FRAMES, 60.0), props=(prop,)))


def write_clip(folder: Path) -> None:
    """Write a short clip as BVH."""
    write_bvh(folder / "clip.bvh", known_motion(load_body(), np.zeros(10), frames=_FRAMES))


def _skeleton(folder: Path) -> None:
    """Write what Blender hands over of a clip."""
    write_clip(folder)
    clip = read_bvh(folder / "clip.bvh", metres_per_unit=0.01, up_axis="y")
    (folder / "clip.bvh").unlink()
    motion = bvh_motion(clip, bvh_skeleton(clip), "clip")
    file = SkeletonFile("clip", motion.names, motion.parents, motion.rest, motion.joints, motion.turns, motion.fps, {})
    write_skeleton(folder / "clip.npz", file)


@cache
def _gloves() -> DrawnGloves:
    whole = drawn_gloves()
    return replace(whole, times=whole.times[:8], points=whole.points[:8], wrists=whole.wrists[:8])


def _with_gloves(folder: Path) -> None:
    _motion(folder)
    hands_bvh(folder / "gloves.bvh", drawn_gloves(), 0, "LeftHand{finger}{number}")
    lines = (folder / "gloves.bvh").read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("Frames:"))
    lines[first] = "Frames: 8"
    (folder / "gloves.bvh").write_text("\n".join(lines[: first + 10]) + "\n")


def _with_manus(folder: Path) -> None:
    _motion(folder)
    manus_csv(folder / "gloves.csv", _gloves(), 0)


TARGETS: tuple[Target, ...] = (
    verb_target("motion convert", (write_clip,), verb("motion convert ./clip.bvh --out ./out.npz"), _BVH),
    verb_target("motion, skeleton", (_skeleton,), verb("motion convert ./clip.npz --out ./out.npz"), _NPZ),
    verb_target("motion, AMASS", (amass(),), verb("motion convert ./a.npz --out ./out.npz"), _NPZ),
    verb_target(
        "hands add", (_with_gloves,), verb("hands add ./motion.npz ./gloves.bvh --offset 0 --out ./out.npz"),
        _BVH | _NPZ,
    ),
    verb_target(
        "hands add, MANUS", (_with_manus,),
        verb("hands add ./motion.npz ./gloves.csv --side left --offset 0 --out ./a.npz"), {".csv": "table"},
    ),
    verb_target("motion props", (_with_prop,), verb("motion props ./motion.npz --out ./out.json"), _NPZ),
    *(
        verb_target(f"motion {words.split()[0]}", (_motion,), verb(f"motion {words}"), _NPZ)
        for words in (
            "trim ./motion.npz ./out.npz --frames 1 4", "mirror ./motion.npz ./out.npz",
            "retime ./motion.npz ./out.npz --speed 2", "resample ./motion.npz ./out.npz --fps 30",
            "in-place ./motion.npz ./out.npz", "root-motion ./motion.npz ./out.npz",
            "join ./motion.npz ./motion.npz ./out.npz",
        )
    ),
    verb_target("motion loop", (), verb("motion loop ./motion.npz ./out.npz"), _NPZ, (_motion,)),  # it is no loop
    verb_target("motion export", (_motion,), verb("motion export ./motion.npz --out ./out"), _NPZ),
    verb_target("motion denoise", (_motion,), verb("motion denoise ./motion.npz ./out.npz"), _NPZ),
    verb_target("motion complete", (_motion,), verb("motion complete ./motion.npz ./out.npz --missing left_arm"), _NPZ),
    verb_target(
        "motion interpolate", (_motion,), verb("motion interpolate ./motion.npz ./out.npz --frames 1 4 --count 2"),
        _NPZ,
    ),
)  # fmt: skip
