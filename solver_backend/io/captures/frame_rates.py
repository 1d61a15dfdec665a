"""Frame rates of cameras against the take's: as videos state them, or as the views show, and which is the take's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic

OTHER_RATE = 0.01
"""Share by which frame rates differ that are not the same: 59.94 is 60."""


def stated_ratios(rates: Sequence[float | None], fps: float) -> np.ndarray:
    """Return (C,) frames of each camera for one of the take, by what the videos state.

    Args:
        rates: (C,) frames a second that the videos state, None where they state nothing.
        fps: frames a second of the take.
    """
    ratios = np.array([fps if rate is None or rate <= 0 else rate for rate in rates]) / fps
    differ = bool((np.abs(ratios / np.median(ratios) - 1) > OTHER_RATE).any())
    return np.where(differ & (np.abs(ratios - 1) > OTHER_RATE), ratios, 1.0)


def of_the_take(relative: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return (C,) frames of each camera for one of the take, and whether the views leave open which is the take's rate.

    The views show how rates are related, not which of them the stated one is. It is that of most cameras; where no rate
    is that of more than half, that of the fastest, so that no frame is lost.

    Args:
        relative: (C,) frames of each for one of any of them.
    """
    same = np.abs(relative[:, None] / relative[None] - 1) <= OTHER_RATE
    usual = int(same.sum(1).argmax())
    if 2 * same[usual].sum() > len(relative):
        return np.where(same[usual], 1.0, relative / relative[usual]), False
    fastest = relative.max()
    return np.where(relative > (1 - OTHER_RATE) * fastest, 1.0, relative / fastest), True


def other_rates(detections: Detections, ratios: np.ndarray, fps: float, *, is_open: bool) -> tuple[Diagnostic, ...]:
    """Return that cameras have other rates than the take's, and whether it is open which is the take's.

    Args:
        ratios: (C,) frames of each for one of the take.
        fps: frames a second of the take.
        is_open: the views leave open which cameras the stated rate is of.
    """
    rates = {name: ratio * fps for name, ratio in zip(detections.cameras, ratios.tolist(), strict=True) if ratio != 1.0}
    named = [f"{name} {rate:.4g}" for name, rate in rates.items()]
    found = diagnostic("camera_rates_differ", cameras=list(rates), rate=fps, rates=named)
    if not is_open:
        return (found,)
    fast = [name for name in detections.cameras if name not in rates]
    return found, diagnostic("frame_rate_ambiguous", cameras=fast, rate=fps)
