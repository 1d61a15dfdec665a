"""A recording of two small sensors that see eight markers rise."""

from __future__ import annotations

from pathlib import Path

from solver_backend.sensors.devices.recorded import Recording, SensorFiles, SensorRecorder
from tests.support.sensor_pictures import Painter, sensors_around, spread_points

CAMERAS = sensors_around(2, (400, 360))
POINTS = spread_points(8, cameras=CAMERAS)
FPS, FRAMES = 60.0, 12


def recorded(folder: Path, kind: str = "raw", frames: int = FRAMES, markers: bool = True) -> Path:
    """Write a recording of markers that rise, and return its folder."""
    painter, recording = Painter(CAMERAS), Recording(folder, kind, FPS, CAMERAS)
    for view, name in enumerate(CAMERAS.names):
        recorder = None
        for k in range(frames):
            points = POINTS + [0, 0, 0.002 * k] if markers else POINTS[:0]
            frame = painter.frame(view, points, k, time=100.0 + k / FPS, number=k)
            if recorder is None:
                recording.add(SensorFiles.of(frame))
                recorder = SensorRecorder(folder, SensorFiles.of(frame), kind, patient=True)
            recorder(frame)
        assert recorder is not None and frame.sensor == name
        recorder.close()
        assert recorder.written == frames and not recorder.dropped and not recorder.ended
    return folder
