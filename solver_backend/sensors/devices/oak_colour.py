"""Record and stream the colour cameras of several OAKs in step.

The device compresses every picture by itself (MJPEG), so a file may begin and end anywhere. The file is a fragmented
MP4 with each picture's own time, readable up to where it was cut off.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from solver_backend.exchange.errors import OutputNotWritable
from solver_backend.exchange.outputs import check_output, write_text
from solver_backend.sensors.devices.device import OpenedDevice, SensorFailed
from solver_backend.sensors.devices.oak import depthai, start_oak
from solver_backend.videos.files.video import library
from solver_backend.videos.streaming.picture_sources import LivePicture
from solver_backend.videos.sync.clocks import Clocks

TICKS = 90_000
"""Of a file's clock a second."""
WAIT_S = 0.001
CLOCKS = "clocks.json"
"""The file of the videos' clocks, as ``Clocks`` writes itself."""


@dataclass(frozen=True)
class ColourPicture:
    """One compressed picture."""

    jpeg: bytes
    time_s: float
    """Seconds of its exposure's middle, on a clock that all cameras share."""


class ColourSource(Protocol):
    """A camera that gives compressed pictures, such as ``OakColour``."""

    name: str
    size: tuple[int, int]
    fps: float

    def open(self) -> None:
        """Connect and start."""
        ...

    def pictures(self) -> Iterator[ColourPicture | None]:
        """Yield pictures as they come, None where there is none yet. Ends with the device."""
        ...

    def close(self) -> None:
        """End."""
        ...


@dataclass
class OakColour(OpenedDevice):
    """The colour camera of one OAK."""

    name: str
    identifier: str
    size: tuple[int, int] = (1920, 1080)
    fps: float = 60.0
    exposure_us: int = 4000
    iso: int = 800
    role: str = "none"
    quality: int = 90
    _pipeline: Any = field(default=None, init=False, repr=False)
    _queue: Any = field(default=None, init=False, repr=False)

    def open(self) -> None:
        """Connect and start.

        Raises:
            SensorFailed: the device is not there, or refuses a setting.
        """
        if self._pipeline is None:
            self._pipeline, self._queue = start_oak(self.identifier, self.name, self.role, self._encoded)

    def _encoded(self, dai: Any, device: Any, pipeline: Any) -> Any:
        camera = pipeline.create(dai.node.Camera).build(dai.CameraBoardSocket.CAM_A, sensorFps=self.fps)
        camera.initialControl.setManualExposure(self.exposure_us, self.iso)
        pictures = camera.requestOutput(self.size, dai.ImgFrame.Type.NV12, fps=self.fps)
        encoder = pipeline.create(dai.node.VideoEncoder).build(
            pictures, frameRate=self.fps, profile=dai.VideoEncoderProperties.Profile.MJPEG, quality=self.quality
        )
        return encoder.out.createOutputQueue(maxSize=int(self.fps), blocking=False)

    def pictures(self) -> Iterator[ColourPicture | None]:
        """Yield pictures as they come, None where there is none yet.

        Raises:
            SensorFailed: the device is not open, or went away.
        """
        if self._queue is None:
            raise SensorFailed("The sensor is not open.", where=f"sensor {self.name}", hint="Open it first.")
        middle = depthai().CameraExposureOffset.MIDDLE
        while self._pipeline is not None and self._pipeline.isRunning():
            try:
                found = self._queue.tryGet()
            except Exception as error:  # depthai's own types
                raise SensorFailed(f"The device was lost: {error}.", where=f"sensor {self.name}") from error
            yield found and ColourPicture(bytes(found.getData()), found.getTimestamp(middle).total_seconds())

    def close(self) -> None:
        """End. May be called several times."""
        pipeline, self._pipeline, self._queue = self._pipeline, None, None
        if pipeline is not None:
            pipeline.stop()


class ColourFile:
    """A video that is written while it is filmed.

    Args:
        path: an MP4.
        size: width and height, px.
        fps: asked for. The pictures keep their own times.
        begin_s: the shared clock's time at which the video begins.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: float, begin_s: float) -> None:
        self.path, self.begin_s, self.count, self.first_s = path, begin_s, 0, begin_s
        self._av = library()
        self._container = self._av.open(str(path), "w", format="mp4", options={"movflags": "frag_keyframe+empty_moov"})
        stream = self._container.add_stream("mjpeg", rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height = size
        stream.pix_fmt = "yuvj420p"
        stream.time_base = Fraction(1, TICKS)
        self._stream, self._last = stream, -1

    def add(self, picture: ColourPicture) -> None:
        """Append a picture. Those before the beginning, or not later than the one before, are skipped.

        Raises:
            OutputNotWritable: the disk is full. What was written stays readable.
        """
        at = round((picture.time_s - self.begin_s) * TICKS)
        if at <= self._last or at < 0:
            return
        packet = self._av.Packet(picture.jpeg)
        packet.pts = packet.dts = at
        packet.time_base, packet.stream, packet.is_keyframe = Fraction(1, TICKS), self._stream, True
        try:
            self._container.mux(packet)
        except OSError as error:
            message = f"The video cannot be written on: {error.strerror}."
            hint = "Check the free space on the disk. What was recorded before can be read."
            raise OutputNotWritable(message, where=str(self.path), hint=hint) from error
        self._last = at
        self.first_s = picture.time_s if self.count == 0 else self.first_s
        self.count += 1

    def close(self) -> None:
        """Finish the file."""
        self._container.close()


def record_colour(
    sources: Mapping[str, ColourSource], folder: Path, size: tuple[int, int], fps: float, seconds: float
) -> dict[str, int]:
    """Write one video a camera, all beginning with the first exposure that every camera has, and return their lengths.

    Args:
        folder: where ``NAME.mp4`` are written; nothing there is replaced.
        size: width and height, px.

    Raises:
        OutputExists: a video is there already.
        OutputNotWritable: the disk is full.
        SensorFailed: a camera gives no picture, or went away.
    """
    for name in sources:
        check_output(folder / f"{name}.mp4", overwrite=False)
    folder.mkdir(parents=True, exist_ok=True)
    streams = {name: source.pictures() for name, source in sources.items()}
    firsts = {name: _first(name, stream) for name, stream in streams.items()}
    begin_s = max(first.time_s for first in firsts.values()) - 0.5 / fps
    files = {name: ColourFile(folder / f"{name}.mp4", size, fps, begin_s) for name in sources}
    try:
        for name, first in firsts.items():
            files[name].add(first)
        _until(streams, files, begin_s + seconds)
    finally:
        for file in files.values():
            file.close()
        _write_clocks(folder / CLOCKS, files)
    return {name: file.count for name, file in files.items()}


def _write_clocks(path: Path, files: Mapping[str, ColourFile]) -> None:
    first = np.array([file.first_s for file in files.values()])
    clocks = replace(Clocks.alike(tuple(files)), offset_s=first[0] - first, method="the devices' stamps")
    write_text(path, json.dumps(clocks.as_dict(), indent=2) + "\n", overwrite=True)


def _first(name: str, stream: Iterable[ColourPicture | None]) -> ColourPicture:
    deadline = time.perf_counter() + 10.0
    for picture in stream:
        if picture is not None:
            return picture
        if time.perf_counter() > deadline:
            break
        time.sleep(WAIT_S)
    raise SensorFailed("The camera gives no picture.", where=f"sensor {name}", hint="A slave waits for its master.")


def _until(
    streams: Mapping[str, Iterator[ColourPicture | None]], files: Mapping[str, ColourFile], end_s: float
) -> None:
    going = dict(streams)
    while going:
        idle = True
        for name, stream in list(going.items()):
            picture = next(stream, StopIteration)
            if picture is StopIteration:
                del going[name]
            elif isinstance(picture, ColourPicture):
                idle = False
                if picture.time_s < end_s:
                    files[name].add(picture)
                else:
                    del going[name]
        if idle and going:
            time.sleep(WAIT_S)


class OakPictures:
    """Pictures as they come, with the times of their exposures, which the devices' clocks share with the host's."""

    def __init__(self, camera: ColourSource) -> None:
        self._camera = camera
        self.name, self.size, self.fps = camera.name, camera.size, camera.fps

    def open(self) -> None:
        """Connect."""
        self._camera.open()

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield pictures as they come.

        Raises:
            SensorFailed: the device went away.
        """
        number = 0
        for picture in self._camera.pictures():
            if picture is None:
                time.sleep(WAIT_S)
                continue
            arrived = time.perf_counter()
            yield LivePicture(number, picture.time_s - start, arrived, partial(_decoded, picture.jpeg))
            number += 1

    def close(self) -> None:
        """Let the device go."""
        self._camera.close()


def _decoded(jpeg: bytes) -> np.ndarray:
    """Return (H, W, 3) of a compressed picture."""
    codec: Any = library().CodecContext.create("mjpeg", "r")
    [frame, *_] = [*codec.decode(library().Packet(jpeg)), *codec.decode(None)]
    return frame.to_ndarray(format="rgb24")
