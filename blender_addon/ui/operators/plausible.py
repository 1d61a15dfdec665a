"""Operators that use the learned pose prior Pose-NDF to denoise, complete or fill a frame range."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from ...errors import TakeMissing
from ..project_files import bring_home
from ..setting_properties import choice
from .base import EDITABLE, TAKE, Call, Steps, operator
from .clips import ALONE, ask, range_of_take

if TYPE_CHECKING:
    from ..._exchange.motion_file import MotionFile

_SHORTEST = 3  # Smallest number of frames in a range. At least one frame must lie between the two ends.


def _reposed(
    context: bpy.types.Context, word: str, words_of: Callable[[MotionFile], tuple[str, list[str]]], *, fades: bool
) -> Steps:
    """Let the solver find new poses for the chosen range, and add a take that contains them.

    ``words_of`` returns the solver's command and options for the motion in the range. With ``fades``, this motion
    includes the frames around the range where the new poses blend in and out.
    """
    from tempfile import TemporaryDirectory

    import numpy as np

    from ..._exchange.clips import take_frames
    from ..._exchange.errors import MotionInvalid
    from ..._exchange.motion_file import read_motion, write_motion
    from ..._exchange.seams import BLEND_S, splice
    from ...scene.clips import add_clip, on_layout, played_motion

    review = context.scene.mocap.review
    take, uid, (first, last) = review.take, review.take.session_uid, range_of_take(review.take, review)
    if last - first + 1 < _SHORTEST:
        message = f"The range has {last - first + 1} frames, and at least {_SHORTEST} are needed."
        raise MotionInvalid(message, where=take.name, hint="Set First and Last under Fix a Range.")
    motion = played_motion(context.scene, review.armature, take)
    fade = round(BLEND_S * motion.fps) if fades else 0
    before, after = min(fade, first), min(fade, motion.num_frames - 1 - last)
    start, shown = first - before, (review.first, review.last)
    part = take_frames(motion, np.arange(start, last + after + 1))
    verb, words = words_of(part)
    with TemporaryDirectory() as folder:
        source, out = Path(folder, "range.npz"), Path(folder, "found.npz")
        write_motion(source, part)
        yield Call(f"motion {verb}", [str(source), str(out), *words], Path(folder))
        found = on_layout(read_motion(out, whole=True), motion.body_layout)
    review = context.scene.mocap.review
    if review.take is None or review.take.session_uid != uid:
        hint = "Show the take again, and try once more."
        raise TakeMissing("Another take was shown while the range was edited.", hint=hint)
    action = add_clip(
        context.scene, review.armature, review.take, word, lambda motion: splice(motion, found, start, (before, after))
    )
    bring_home()
    return f"'{action.name}' has new poses in frames {shown[0]} to {shown[1]}"


@operator("Denoise Range", TAKE, EDITABLE, ALONE)
def denoise_range(self: Any, context: bpy.types.Context) -> Steps:
    """Add a take with smoother, more natural poses from First to Last (Pose-NDF)."""
    return (yield from _reposed(context, "denoised", lambda part: ("denoise", []), fades=True))


_LIMB = choice("Limb", "Arm, leg, trunk or head to replace with new poses", "complete_limb.limb")


@operator("Complete Limb", TAKE, EDITABLE, ALONE, invoke=ask, limb=_LIMB)
def complete_limb(self: Any, context: bpy.types.Context) -> Steps:
    """Add a take that replaces one limb from First to Last with natural poses that match the body (Pose-NDF)."""
    return (yield from _reposed(context, "completed", lambda part: ("complete", ["--missing", self.limb]), fades=True))


@operator("In-Between", TAKE, EDITABLE, ALONE)
def fill_between(self: Any, context: bpy.types.Context) -> Steps:
    """Add a take with natural poses between the poses at First and Last (Pose-NDF)."""

    def words_of(part: MotionFile) -> tuple[str, list[str]]:
        count = part.num_frames
        return "interpolate", ["--frames", "0", str(count - 1), "--count", str(count - 2)]

    return (yield from _reposed(context, "in-between", words_of, fades=False))
