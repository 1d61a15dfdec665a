"""Merge a range that was solved again into a take. Keys outside the range keep their exact values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..body.controls.limbs import CONTROLS, FINGER_CONTROLS, LIMBS, Limb, limb_paths, switch_path
from .curves import CurveTarget, action_curves

_POINTS = ("co", "handle_left", "handle_right")
_CHOICES = ("interpolation", "easing", "handle_left_type", "handle_right_type", "type")
_KEY = np.dtype(
    [(name, np.int32) for name in _CHOICES]
    + [(name, np.float32, 2) for name in _POINTS]
    + [(name, np.float32) for name in ("back", "amplitude", "period")]
)
"""Blender's fields of a keyframe point. Handle types precede handle positions, because the positions depend on them."""
_LINEAR = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value


def _read_keys(curve: bpy.types.FCurve) -> np.ndarray:
    keys = np.empty(len(curve.keyframe_points), _KEY)
    for name in _KEY.names or ():
        values = np.empty(keys[name].size, keys[name].dtype)
        curve.keyframe_points.foreach_get(name, values)
        keys[name] = values.reshape(keys[name].shape)
    return keys


def _write_keys(curve: bpy.types.FCurve, keys: np.ndarray) -> None:
    points = curve.keyframe_points
    points.clear()
    points.add(len(keys))
    for name in _KEY.names or ():
        points.foreach_set(name, keys[name].ravel())
    curve.update()


def carry_curves(source: bpy.types.Action, target: CurveTarget, start: float, ratio: float) -> None:
    """Copy the user's own curves to a newly solved take, with their times scaled by ``ratio`` around ``start``."""
    written = {(curve.data_path, curve.array_index) for curve in target.container.fcurves}
    left = tuple(f'pose.bones["{name}"]' for name in (*CONTROLS, *FINGER_CONTROLS))
    for curve in action_curves(source):
        place = curve.data_path, curve.array_index
        if place in written or curve.data_path.startswith(left):
            continue
        keys = _read_keys(curve)
        for name in _POINTS:
            keys[name][:, 0] = start + (keys[name][:, 0] - start) * ratio
        new = target.container.fcurves.new(curve.data_path, index=curve.array_index)
        _write_keys(new, keys)
        new.extrapolation, new.mute = curve.extrapolation, curve.mute


def _times(keys: np.ndarray) -> np.ndarray:
    return keys["co"][:, 0].astype(np.float64)


def _linear_keys(times: np.ndarray, values: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return linear keys at (K,) times with (K,) values. All other fields are copied from ``like``."""
    keys = np.repeat(like[:1], len(times))
    for name in _POINTS:
        keys[name] = np.stack([times, values], axis=1)
    keys["interpolation"] = _LINEAR
    return keys


_NEAR = 1e-3  # A key closer to a frame than this, in scene frames, is on that frame.
_SWITCHES = tuple(switch_path(limb) for limb in LIMBS)


@dataclass(frozen=True)
class RangeTimes:
    """First and last scene frame of a range in a take, and the step between its frames."""

    first: float
    last: float
    step: float  # Scene frames between two frames of the take.

    def holds(self, times: np.ndarray) -> np.ndarray:
        """Return a mask of the (K,) times inside the range."""
        return (times > self.first - _NEAR) & (times < self.last + _NEAR)

    def between(self, after: float, before: float) -> np.ndarray:
        """Return the scene frames of the take's frames that are strictly between two times."""
        low, high = (int(np.ceil(round((t - self.first) / self.step, 3))) for t in (after, before))
        frames = self.first + self.step * np.arange(low, high)
        return frames[(frames > after + _NEAR) & (frames < before - _NEAR)]


def ends_used(edited: bpy.types.Action, times: RangeTimes) -> list[Limb]:
    """Return the limbs that an action poses by IK in at least one frame of a range."""
    frames = times.first + times.step * np.arange(round((times.last - times.first) / times.step) + 1)
    switches = {curve.data_path: curve for curve in action_curves(edited) if curve.data_path in _SWITCHES}
    keyed = {curve.data_path for curve in action_curves(edited)}
    used = [limb for limb in LIMBS if switch_path(limb) in switches and limb_paths(limb) <= keyed]
    return [limb for limb in used if any(switches[switch_path(limb)].evaluate(frame) > 0 for frame in frames)]


def merge_range(
    edited: bpy.types.Action, solved: bpy.types.Action, times: RangeTimes, placed: Sequence[Limb] = ()
) -> None:
    """Replace a range of an edited action by the new solution, and keep all other keys.

    Limbs in ``placed`` have keys on their IK controls in the solved action, so they keep their IK switches. All other
    limbs switch to FK inside the range.
    """
    kept = {switch_path(limb) for limb in placed}
    new = {(curve.data_path, curve.array_index): curve for curve in action_curves(solved)}
    old = {(curve.data_path, curve.array_index): curve for curve in action_curves(edited)}
    signs = _signs(old, new, times)
    for place, curve in old.items():
        if curve.data_path in kept:
            continue
        if curve.data_path in _SWITCHES:
            _switch_off(curve, times)
        elif place in new:
            _replace(curve, new[place], times, signs.get(curve.data_path, 1.0))


def _signs(old: dict, new: dict, times: RangeTimes) -> dict[str, float]:
    """Return a sign (1 or -1) per quaternion. New curves multiplied by it continue the old ones without a flip."""
    before = times.first - times.step
    products: dict[str, float] = {}
    for (path, index), curve in new.items():
        if path.endswith("rotation_quaternion") and (path, index) in old:
            product = curve.evaluate(times.first) * old[path, index].evaluate(before)
            products[path] = products.get(path, 0.0) + product
    return {path: -1.0 if product < 0 else 1.0 for path, product in products.items()}


def _replace(curve: bpy.types.FCurve, solved: bpy.types.FCurve, times: RangeTimes, sign: float) -> None:
    """Replace a curve's keys inside a range by the solved keys, and preserve the curve outside the range."""
    old, new = _read_keys(curve), _inside(solved, times, sign)
    if not len(old) or _is_constant(old, new):
        return
    at = _times(old)
    left, right = old[at < times.first - _NEAR], old[at > times.last + _NEAR]
    parts = [left, _bridge(curve, times, left, before=True), new, _bridge(curve, times, right, before=False), right]
    _write_keys(curve, np.concatenate(parts))


def _inside(solved: bpy.types.FCurve, times: RangeTimes, sign: float) -> np.ndarray:
    keys = _read_keys(solved)
    inside = keys[times.holds(_times(keys))]
    if not len(inside) or len(keys) == 1:  # the curve is constant
        ends = np.unique([times.first, times.last])
        inside = _linear_keys(ends, np.array([solved.evaluate(time) for time in ends]), keys)
    for name in _POINTS:
        inside[name][:, 1] *= sign
    return inside


def _is_constant(old: np.ndarray, new: np.ndarray) -> bool:
    return len(old) == 1 and bool((new["co"][:, 1] == old["co"][0, 1]).all())


def _bridge(curve: bpy.types.FCurve, times: RangeTimes, kept: np.ndarray, *, before: bool) -> np.ndarray:
    """Return keys that preserve the old curve between a range and the nearest kept key before or after it."""
    near = times.first if before else times.last
    if len(kept):
        far = float(_times(kept)[-1 if before else 0])
        frames = times.between(far, near) if before else times.between(near, far)
        if before and len(frames):
            kept["interpolation"][-1] = _LINEAR
    else:  # outside its keys a curve is constant
        frames = np.array([near - times.step if before else near + times.step])
    return _linear_keys(frames, np.array([curve.evaluate(frame) for frame in frames]), _read_keys(curve))


def _switch_off(curve: bpy.types.FCurve, times: RangeTimes) -> None:
    ends = np.array([times.first - times.step, times.first, times.last, times.last + times.step])
    values = np.array([curve.evaluate(ends[0]), 0.0, 0.0, curve.evaluate(ends[3])])
    old = _read_keys(curve)
    if not len(old) or not (old["co"][:, 1].any() or values.any()):
        return
    at = _times(old)
    parts = old[at < ends[0] - _NEAR], _linear_keys(ends, values, old), old[at > ends[3] + _NEAR]
    _write_keys(curve, np.concatenate(parts))
