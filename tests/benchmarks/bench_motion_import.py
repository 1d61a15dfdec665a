"""Fit twenty BVH files, twenty clips of a CC0 library (GLB) and twenty CMU takes to our body, and some to rigs.

For each kind the figures are the root mean square distance of the limbs' joints from the skeleton's, of the worst joint
of any clip and of the median clip. Others are the largest joint rotation between two frames that the skeleton does not
have in the same place, the number of clips with an arm, leg or head without a joint, and frames per second of processor
time for reading and fitting (without Blender's own reading). Five clips of each kind are retargeted to characters that
are named and built like Unreal's and a VRM's, without a map. Their figures are distances of hands and feet from the
positions scaled by the legs.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import numpy as np

from blender_addon._exchange.motion_file import read_motion
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.retarget import retarget
from solver_backend.body.body import Body, load_body
from solver_backend.exchange.rigs.skeleton import JOINT_OF
from solver_backend.fitters.motion_import.import_motion import ImportedMotion, import_motion
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.motions.foreign_skeleton import read_foreign_clip
from solver_backend.io.native.motion_file import write_motion
from solver_backend.types import Motion, SkeletonMotion
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.conftest import recordings_folder
from tests.support.foreign_clips import bvh_files, cmu_files, library_files
from tests.support.foreign_files import CHARACTERS
from tests.support.retarget_measures import score
from tests.support.retarget_rigs import map_of_rig

COUNT, ON_RIGS, MOST_FRAMES = 20, 5, 200
"""Clips per kind, how many of them are retargeted to rigs, and frames of the retargeted clips."""
KINDS: dict[str, Callable[[Path, Path, int], Iterable[Path]]] = {
    "bvh": bvh_files, "cmu": cmu_files, "library": library_files,
}  # fmt: skip
RIGS = ("unreal_fbx", "vrm")
_LOOSE = ("toe", "head")
"""Joints that are not fitted by position."""


@dataclass(frozen=True)
class Clip:
    """Figures of one clip."""

    frames: int
    cpu_s: float
    limbs_mm: float
    """Root mean square over joints and frames in millimetres."""
    joint_mm: float
    """Root mean square of the worst joint over the frames in millimetres."""
    flip_deg: float
    lacking: bool

    def row(self) -> str:
        """Return the clip as a row of text."""
        return (
            f"{self.frames:5d} frames {self.cpu_s:6.2f} s {self.limbs_mm:6.1f} mm, worst joint {self.joint_mm:6.1f} mm"
            f", turn {self.flip_deg:5.1f}°{' LACKING' * self.lacking}"
        )


def run() -> list[Metric]:
    """Fit the clips to our body, and some of them to rigs."""
    shared = recordings_folder()
    if not (shared / "motion_cmu" / "asfamc").is_dir():
        raise BenchmarkSkipped("there are no recordings beside the repository")
    body, metrics, motions = load_body(), [], []
    with TemporaryDirectory() as folder:
        for kind, files in KINDS.items():
            (place := Path(folder) / kind).mkdir()
            clips = []
            for k, path in enumerate(files(shared, place, COUNT)):
                clip, done = measured(path, body)
                clips.append(clip)
                sys.stdout.write(f"  {kind:<8}{path.stem:<28}{clip.row()}\n")
                if k % (COUNT // ON_RIGS) == 0 and clip.frames > 1:
                    write_motion(place / f"{k}.motion.npz", beginning(done.motion), name=path.stem)
                    motions.append(place / f"{k}.motion.npz")
            metrics += metrics_of(kind, clips)
        return [*metrics, *on_rigs(motions)]


def beginning(motion: Motion) -> Motion:
    """Return the first frames of a motion."""
    fields = ("global_orient", "body_pose", "transl", "joints", "contacts", "joint_sigma")
    return replace(motion, **{name: getattr(motion, name)[:MOST_FRAMES] for name in fields})


def measured(path: Path, body: Body) -> tuple[Clip, ImportedMotion]:
    """Fit one clip to our body and measure it."""
    start = time.process_time()
    source, roles, found = read_foreign_clip(path)
    done = import_motion(source, roles, body)
    seconds = time.process_time() - start
    placed = [off for role, off in done.distances_mm.items() if not role.endswith(_LOOSE)]
    rms = float(np.sqrt(np.mean(np.square(placed))))
    lacking = any(item.code == "motion_limbs_missing" for item in found)
    return Clip(source.num_frames, seconds, rms, max(placed), flips_deg(source, roles, done), lacking), done


def flips_deg(source: SkeletonMotion, roles: dict[str, str], done: ImportedMotion) -> float:
    """Return the largest excess in degrees of a joint's rotation between two frames over the source's nearby joints."""
    if source.num_frames < 2:
        return 0.0
    pose = done.motion.body_pose.reshape(source.num_frames, -1, 3)
    own = _steps(exp_so3(np.concatenate([done.motion.global_orient[:, None], pose], axis=1)))
    parents = np.array(source.parents)
    local = np.swapaxes(source.turns[:, np.maximum(parents, 0)], -1, -2) @ source.turns
    local[:, parents < 0] = source.turns[:, parents < 0]
    theirs = _steps(local).max(axis=1)
    limbs = [JOINT_OF[role] for role in JOINT_OF if role in roles]
    return float((own[:, limbs].max(axis=1) - theirs).max().clip(0.0))


def _steps(R: np.ndarray) -> np.ndarray:
    """Return the (F - 1, J) angles in degrees between consecutive frames of (F, J, 3, 3) rotations."""
    return np.degrees(np.linalg.norm(log_so3(np.swapaxes(R[:-1], -1, -2) @ R[1:]), axis=-1))


def metrics_of(kind: str, clips: list[Clip]) -> list[Metric]:
    """Return the figures of the clips of one kind."""
    frames, seconds = sum(clip.frames for clip in clips), sum(clip.cpu_s for clip in clips)
    return [
        Metric(f"{kind}_clips", len(clips), "", "higher", rel_tol=0.0),
        Metric(f"{kind}_lacking_limbs", sum(clip.lacking for clip in clips), "", rel_tol=0.0),
        Metric(f"{kind}_limbs_median_mm", float(np.median([clip.limbs_mm for clip in clips])), "mm", abs_tol=0.2),
        Metric(f"{kind}_limbs_worst_mm", max(clip.limbs_mm for clip in clips), "mm", abs_tol=0.3),
        Metric(f"{kind}_within_10_mm", sum(clip.limbs_mm <= 10.0 for clip in clips), "", "higher", rel_tol=0.0),
        Metric(f"{kind}_joint_worst_mm", max(clip.joint_mm for clip in clips), "mm", abs_tol=0.5),
        Metric(f"{kind}_flip_deg", max(clip.flip_deg for clip in clips), "°", abs_tol=5.0),
        Metric(f"{kind}_frames_per_cpu_s", frames / seconds, "1/s", "higher", rel_tol=0.5),
    ]


def on_rigs(motions: list[Path]) -> list[Metric]:
    """Retarget motions to each character and return the worst figures."""
    body, metrics = read_body(default_body_path()), []
    for kind in RIGS:
        scores = []
        for path in motions:
            with TemporaryDirectory() as folder:
                rig, limbs = CHARACTERS[kind](Path(folder))
                motion = read_motion(path)
                timing = TakeTiming(1, motion.fps)
                retarget(actor_of_motion(motion, body), rig, bpy.context.scene, map_of_rig(rig), timing)
                times = timing.scene_frames(motion.num_frames, motion.fps)
                scores.append(score(rig, limbs, motion, body, times))
        metrics += [
            Metric(f"{kind}_hands_mm", max(s.hands_mm for s in scores), "mm", abs_tol=1.0),
            Metric(f"{kind}_feet_mm", max(s.feet_mm for s in scores), "mm", abs_tol=1.0),
            Metric(f"{kind}_twist_deg", max(s.twist_deg for s in scores), "°", abs_tol=0.5),
        ]
    return metrics
