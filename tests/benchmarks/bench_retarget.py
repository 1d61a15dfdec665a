"""Retarget three solved takes (walk, squat, dance, four views each) to Rigify, two Mixamo-named rigs and other files.

The characters are written and read as their programs' users have them: glTF, FBX, VRM, and an avatar at scale 0.01.
Figures are the worst of the three takes: largest distances of hands and feet from the scaled actor's over all frames,
with feet locked in stances that slide by up to 30 mm, and largest differences in the twist of hinges, of hands to
forearms, of thighs to the pelvis, and of the pelvis. Others are the mean world angles of trunk and head to the actor's,
the path length of the hips relative to the ratio of the legs, and of standing toes relative to the actor's. They are
measured in Blender on the evaluated rigs. Processor seconds for 1,000 frames are of the whole verb for the longest
take, including reading and checking the rig.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy

from blender_addon._exchange.motion_file import read_motion
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.conventions.timing import TakeTiming
from blender_addon.retarget.motion.figures import actor_of_motion
from blender_addon.retarget.retarget import retarget
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import solve
from solver_backend.io.native.motion_file import write_motion
from tests.benchmarks.comparison.captures import filmed
from tests.benchmarks.metric import Metric
from tests.support.foreign_files import CHARACTERS
from tests.support.retarget_measures import Score, score
from tests.support.retarget_rigs import map_of_rig, mixamo, rigify

TAKES = {"walk": "08_01:0+139", "squat": "13_29:2050+240", "dance": "salsa_07:20+300"}
RIGS: dict[str, Callable] = {
    "mixamo_short": mixamo, "mixamo_tall_a": lambda: mixamo("tall", arms_down_deg=40.0), "rigify": rigify,
}  # fmt: skip


def run() -> list[Metric]:
    """Solve each take and retarget it to each rig."""
    body, metrics, seconds = read_body(default_body_path()), [], []
    worst: dict[str, list[Score]] = {name: [] for name in CHARACTERS}
    for name, take in TAKES.items():
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}.npz"
            write_motion(path, solve(filmed(take), SolveSettings()).motion)
            motion = read_motion(path)
        for kind, make in RIGS.items():
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            rig, limbs = make()
            timing, start = TakeTiming(1, motion.fps), time.process_time()
            retarget(actor_of_motion(motion, body), rig, bpy.context.scene, map_of_rig(rig), timing)
            seconds.append((time.process_time() - start) * 1000 / motion.num_frames)
            found = score(rig, limbs, motion, body, timing.scene_frames(motion.num_frames, motion.fps))
            key = f"{name}_{kind}"
            metrics += [
                Metric(f"{key}_hands_mm", found.hands_mm, "mm", abs_tol=1.0),
                Metric(f"{key}_feet_mm", found.feet_mm, "mm", abs_tol=1.0),
                Metric(f"{key}_twist_deg", found.twist_deg, "°", abs_tol=0.5),
                Metric(f"{key}_wrists_deg", found.wrists_deg, "°", abs_tol=0.5),
                Metric(f"{key}_hips_deg", found.hips_deg, "°", abs_tol=0.5),
                Metric(f"{key}_pelvis_deg", found.pelvis_deg, "°", abs_tol=0.5),
                Metric(f"{key}_trunk_deg", found.trunk_deg, "°", abs_tol=0.5),
                Metric(f"{key}_head_deg", found.head_deg, "°", abs_tol=0.5),
                Metric(f"{key}_skating_ratio", found.skating / found.skating_actor, "", abs_tol=0.02),
            ]
        with TemporaryDirectory() as folder:
            for kind, character in CHARACTERS.items():
                rig, limbs = character(Path(folder))
                timing = TakeTiming(1, motion.fps)
                retarget(actor_of_motion(motion, body), rig, bpy.context.scene, map_of_rig(rig), timing)
                times = timing.scene_frames(motion.num_frames, motion.fps)
                worst[kind].append(score(rig, limbs, motion, body, times))
    for kind, scores in worst.items():
        metrics += [
            Metric(f"{kind}_hands_mm", max(s.hands_mm for s in scores), "mm", abs_tol=1.0),
            Metric(f"{kind}_feet_mm", max(s.feet_mm for s in scores), "mm", abs_tol=1.0),
            Metric(f"{kind}_twist_deg", max(s.twist_deg for s in scores), "°", abs_tol=0.5),
            Metric(f"{kind}_wrists_deg", max(s.wrists_deg for s in scores), "°", abs_tol=0.5),
            Metric(f"{kind}_hips_deg", max(s.hips_deg for s in scores), "°", abs_tol=0.5),
            Metric(f"{kind}_pelvis_deg", max(s.pelvis_deg for s in scores), "°", abs_tol=0.5),
            Metric(f"{kind}_trunk_deg", max(s.trunk_deg for s in scores), "°", abs_tol=0.5),
            Metric(f"{kind}_head_deg", max(s.head_deg for s in scores), "°", abs_tol=0.5),
            Metric(f"{kind}_path_off", max(abs(s.path_ratio - 1.0) for s in scores), "", abs_tol=0.002),
        ]
    return [*metrics, Metric("cpu_s_1000_frames", max(seconds[-len(RIGS) :]), "s", rel_tol=1.0)]
