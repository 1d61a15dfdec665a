"""Keys at another layout's times."""

from __future__ import annotations

from solver_backend.fitters.model.keyframe_curve import KeyframeCurve
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Keyframes, hemisphere_aligned


def resampled(keys: Keyframes, layout: KeyframeLayout, finer: KeyframeLayout) -> Keyframes:
    """Return keys at another layout's times, on the curves through the given keys."""
    window, time = layout.positions(finer.key_times)
    curve = KeyframeCurve.through(keys.of_windows(window), time[:, None], residuals=True)
    assert curve.residual is not None
    return hemisphere_aligned(
        Keyframes(curve.codes.value[:, 0], curve.root.quat[:, 0], curve.root.transl, curve.residual)
    )
