"""What a calibration by wand says of itself: lines for people, plain values for programs."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.sensors.wand.result import WandCalibration


def told_lines(found: WandCalibration) -> list[str]:
    """Return what was found, a line each."""
    rig, cameras = found.rig, found.rig.cameras
    held_out = f", {found.held_out_px:.2f} px held out" if np.isfinite(found.held_out_px) else ""
    lines = [f"{len(cameras)} sensors by {rig.method} at {found.moments} moments, {rig.rmse_px:.2f} px{held_out}"]
    if np.isfinite(found.length_rmse_m).all():
        first, second, whole = 1e3 * found.length_rmse_m
        lines.append(f"  lengths     {first:.2f}, {second:.2f} and {whole:.2f} mm RMS, held out")
    if np.isfinite(found.depth_rmse_m):
        lines.append(f"  depth       {1e3 * found.depth_rmse_m:.1f} mm of one measurement")
    for c, name in enumerate(cameras.names):
        x, y, z = np.round(cameras.centres[c], 3) + 0.0
        lines.append(
            f"  {name:<11} {rig.camera_rmse_px[c]:.2f} px, at ({x:.3f}, {y:.3f}, {z:.3f}) m "
            f"± {1e3 * rig.centre_sigma_m[c]:.1f} mm, ± {np.degrees(rig.turn_sigma[c]):.3f}°"
        )
    lines += [f"  clock       {line}" for line in found.clocks.lines()]
    lines += [f"  seen        {line}" for line in found.coverage.lines()]
    if place := found.coverage.next_place():
        lines.append(f"  next        {place}")
    lines += [f"  note        {note}" for note in rig.notes]
    return lines + [f"  finding     {word}" for word in rig.findings]


def told_values(found: WandCalibration) -> dict[str, Any]:
    """Return the same as plain JSON values; None where a number is not known."""
    rig, cameras = found.rig, found.rig.cameras
    return {
        "method": rig.method, "moments": found.moments, "rmse_px": _number(rig.rmse_px),
        "held_out_px": _number(found.held_out_px), "depth_rmse_mm": _number(1e3 * found.depth_rmse_m),
        "length_rmse_mm": [_number(1e3 * v) for v in found.length_rmse_m.tolist()],
        "cameras": [
            {
                "name": name, "rmse_px": _number(rig.camera_rmse_px[c]), "centre_m": cameras.centres[c].tolist(),
                "centre_sigma_mm": _number(1e3 * rig.centre_sigma_m[c]),
                "turn_sigma_deg": _number(np.degrees(rig.turn_sigma[c])), "covered": float(found.coverage.shares[c]),
            }
            for c, name in enumerate(cameras.names)
        ],
        "together": found.together.tolist(), "clocks": found.clocks.as_dict(),
        "next": found.coverage.next_place(), "volume_m3": found.coverage.volume_m3,
        "findings": list(rig.findings), "notes": list(rig.notes),
    }  # fmt: skip


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
