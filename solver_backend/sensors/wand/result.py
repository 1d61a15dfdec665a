"""What a wand is told to be, and what its calibration gives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.extrinsics.result import RigCalibration
from solver_backend.sensors.gravity.gamma import Ground
from solver_backend.sensors.wand.coverage import Coverage
from solver_backend.sensors.wand.leds import Wand
from solver_backend.videos.sync.clocks import Clocks


@dataclass(frozen=True)
class WandOptions:
    """How a wand's recording is taken."""

    wand: Wand | None = None
    """Three lights; None is one marker with depth."""
    clocks: Clocks | None = None
    """Told by a trigger; None has them found from the wand's movement."""
    every_sensor: bool = False
    """Only moments at which all sensors saw it, as published; else two are enough."""


@dataclass(frozen=True)
class WandCalibration:
    """The result, in the first sensor's axes until it is laid on a Γ."""

    rig: RigCalibration
    """Cameras with deviations, findings and notes."""
    clocks: Clocks
    """Of the sensors."""
    together: np.ndarray
    """(C, C) moments that two sensors saw together."""
    moments: int
    """Moments that were solved."""
    held_out_px: float
    """Root mean squared reprojection error of stretches of time that were left out of the fit."""
    length_rmse_m: np.ndarray
    """(3,) root mean squared error of the lights' distances over those stretches; NaN without lights."""
    depth_rmse_m: float
    """Spread of measured depths about the marker; NaN without depth."""
    coverage: Coverage
    """Where the wand was."""


def in_world(found: WandCalibration, rig: RigCalibration, ground: Ground) -> WandCalibration:
    """Return the result in the world of a Γ.

    Args:
        found: in the first sensor's axes.
        rig: the same cameras in the Γ's world.
        ground: how it was found.
    """
    note = (
        f"Up by a Γ in {ground.frames} clouds, ± {np.degrees(ground.tilt_sigma):.2f}°; the origin lies on the floor "
        "below its corner, X along its short edge."
    )
    rig = replace(rig, notes=(found.rig.notes[0], note), findings=(*rig.findings, *ground.findings))
    return replace(found, rig=rig)
