"""What a wand is stated to be, and what its calibration gives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.extrinsics.result import CalibratedCameras
from solver_backend.exchange.diagnostics import diagnostic, sentence
from solver_backend.sensors.wand.coverage import Coverage
from solver_backend.sensors.wand.gamma import Ground
from solver_backend.sensors.wand.leds import Wand
from solver_backend.videos.sync.clocks import Clocks


@dataclass(frozen=True)
class WandOptions:
    """How a wand's recording is taken."""

    wand: Wand | None = None
    """Three lights; None is one marker with depth."""
    clocks: Clocks | None = None
    """Given by a trigger; None has them found from the wand's movement."""
    every_sensor: bool = False
    """Only moments at which all sensors saw it, as published; else two are enough."""


@dataclass(frozen=True)
class WandCalibration:
    """The result, in the first sensor's axes until it is laid on a Γ."""

    array: CalibratedCameras
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

    def lines(self) -> list[str]:
        """Return what was found, a line each."""
        array, cameras = self.array, self.array.cameras
        held_out = f", {self.held_out_px:.2f} px held out" if np.isfinite(self.held_out_px) else ""
        lines = [
            f"{len(cameras)} sensors by {array.method} at {self.moments} moments, {array.rmse_px:.2f} px{held_out}"
        ]
        if np.isfinite(self.length_rmse_m).all():
            first, second, whole = 1e3 * self.length_rmse_m
            lines.append(f"  lengths     {first:.2f}, {second:.2f} and {whole:.2f} mm RMS, held out")
        if np.isfinite(self.depth_rmse_m):
            lines.append(f"  depth       {1e3 * self.depth_rmse_m:.1f} mm of one measurement")
        for c, name in enumerate(cameras.names):
            x, y, z = np.round(cameras.centres[c], 3) + 0.0
            lines.append(
                f"  {name:<11} {array.camera_rmse_px[c]:.2f} px, at ({x:.3f}, {y:.3f}, {z:.3f}) m "
                f"± {1e3 * array.centre_sigma_m[c]:.1f} mm, ± {np.degrees(array.turn_sigma[c]):.3f}°"
            )
        lines += [f"  clock       {line}" for line in self.clocks.lines()]
        lines += [f"  seen        {line}" for line in self.coverage.lines()]
        if place := self.coverage.next_place():
            lines.append(f"  next        {place}")
        lines += [f"  note        {sentence(note)}" for note in array.notes]
        return lines + [f"  finding     {sentence(found)}" for found in array.findings]

    def as_dict(self) -> dict[str, object]:
        """Return ``lines`` as plain JSON values; None where a number is not known."""
        array, cameras = self.array, self.array.cameras
        return {
            "method": array.method, "moments": self.moments, "rmse_px": _number(array.rmse_px),
            "held_out_px": _number(self.held_out_px), "depth_rmse_mm": _number(1e3 * self.depth_rmse_m),
            "length_rmse_mm": [_number(1e3 * v) for v in self.length_rmse_m.tolist()],
            "cameras": [
                {
                    "name": name, "rmse_px": _number(array.camera_rmse_px[c]), "centre_m": cameras.centres[c].tolist(),
                    "centre_sigma_mm": _number(1e3 * array.centre_sigma_m[c]),
                    "turn_sigma_deg": _number(np.degrees(array.turn_sigma[c])),
                    "covered": float(self.coverage.shares[c]),
                }
                for c, name in enumerate(cameras.names)
            ],
            "together": self.together.tolist(), "clocks": self.clocks.as_dict(),
            "next": self.coverage.next_place(), "volume_m3": self.coverage.volume_m3,
            "findings": [sentence(item) for item in array.findings], "notes": [sentence(item) for item in array.notes],
            "diagnostics": [item.as_dict() for item in (*array.findings, *array.notes)],
        }  # fmt: skip


def in_world(found: WandCalibration, array: CalibratedCameras, ground: Ground) -> WandCalibration:
    """Return the result in the world of a Γ.

    Args:
        found: in the first sensor's axes.
        array: the same cameras in the Γ's world.
        ground: how it was found.
    """
    note = diagnostic("world_by_gamma", clouds=ground.frames, sigma_deg=np.degrees(ground.tilt_sigma))
    array = replace(array, notes=(found.array.notes[0], note), findings=(*array.findings, *ground.findings))
    return replace(found, array=array)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
