"""Record and stream the colour cameras of several OAKs in step."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from solver_backend.exchange.errors import OutputNotWritable
from solver_backend.exchange.outputs import check_output, write_text
from solver_backend.sensors.devices.device import SensorFailed
from solver_backend.sensors.devices.oak import OakPipeline, depthai
from solver_backend.videos.files.video import library
from solver_backend.videos.streaming.moments import LivePicture
from solver_backend.videos.sync.clocks import Clocks

TICKS = 90_000  # Ticks of a file's clock per second.
WAIT_S = 0.001  # Time between looks at an empty queue, in seconds.
CLOCKS = "clocks.json"  # File of the videos' clocks, see ``Clocks``.


@dataclass(frozen=True)
class ColourPicture:
    """One compressed picture."""

    jpeg: bytes
    time_s: float  # Middle of the exposure in seconds, on a clock that all cameras share.


class ColourSource(Protocol):
    """A camera with compressed pictures, such as ``OakColour``."""

    name: str
    size: tuple[int, int]
    fps: float

    def open(self) -> None:
        """Connect and start."""
        ...

    def pictures(self) -> Iterator[ColourPicture | None]:
        """Yield pictures as they come, None while there is none, until the device ends."""
        ...

    def close(self) -> None:
        """End."""
        ...


@dataclass
class OakColour(OakPipeline):
    """The colour camera of one OAK. The device compresses each picture alone (MJPEG), so a file may end anywhere."""

    size: tuple[int, int] = (1920, 1080)
    fps: float = 60.0
    exposure_us: int = 4000
    iso: int = 800
    role: str = "none"
    quality: int = 90

    def _role(self) -> str:
        return self.role

    def _build(self, dai: Any, device: Any, pipeline: Any) -> Any:
        camera = pipeline.create(dai.node.Camera).build(dai.CameraBoardSocket.CAM_A, sensorFps=self.fps)
        camera.initialControl.setManualExposure(self.exposure_us, self.iso)
        pictures = camera.requestOutput(self.size, dai.ImgFrame.Type.NV12, fps=self.fps)
        encoder = pipeline.create(dai.node.VideoEncoder).build(
            pictures, frameRate=self.fps, profile=dai.VideoEncoderProperties.Profile.MJPEG, quality=self.quality
        )
        return encoder.out.createOutputQueue(maxSize=int(self.fps), blocking=False)

    def pictures(self) -> Iterator[ColourPicture | None]:
        """Yield pictures as they come, None while there is none. Raise SensorFailed if the device was lost."""
        self._require_open()
        middle = depthai().CameraExposureOffset.MIDDLE
        while self._pipeline is not None and self._pipeline.isRunning():
            try:
                found = self._queue.tryGet()
            except Exception as error:  # depthai raises its own types
                raise SensorFailed(f"The device was lost: {error}.", where=f"sensor {self.name}") from error
            yield found and ColourPicture(bytes(found.getData()), found.getTimestamp(middle).total_seconds())


class ColourFile:
    """A fragmented MP4 that grows while it is filmed, readable up to where it was cut off.

    Pictures keep their own times after ``begin_s`` on the shared clock. ``fps`` is nominal.
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
        """Append a picture, unless it is before the start or not later than the last one. Raise OutputNotWritable."""
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
    """Write ``NAME.mp4`` per camera, all starting at the first exposure of all cameras. Return their numbers of frames.

    Raises:
        OutputExists: a video exists already.
        OutputNotWritable: the disk is full.
        SensorFailed: a camera gives no picture, or was lost.
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
        first = np.array([file.first_s for file in files.values()])
        clocks = replace(Clocks.alike(tuple(files)), offset_s=first[0] - first, method="the devices' stamps")
        write_text(folder / CLOCKS, json.dumps(clocks.as_dict(), indent=2) + "\n", overwrite=True)
    return {name: file.count for name, file in files.items()}


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
            if picture is StopIteration or (isinstance(picture, ColourPicture) and picture.time_s >= end_s):
                del going[name]
            elif isinstance(picture, ColourPicture):
                files[name].add(picture)
            else:
                continue
            idle = False
        if idle:
            time.sleep(WAIT_S)


class OakPictures:
    """Live pictures of a camera with the times of their exposures, on a clock that devices and host share."""

    def __init__(self, camera: ColourSource) -> None:
        self._camera = camera
        self.name, self.size, self.fps = camera.name, camera.size, camera.fps

    def open(self) -> None:
        """Connect."""
        self._camera.open()

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield pictures as they come. Raise ``SensorFailed`` if the device was lost."""
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
    """Return the (H, W, 3) RGB picture."""
    codec: Any = library().CodecContext.create("mjpeg", "r")
    [frame, *_] = [*codec.decode(library().Packet(jpeg)), *codec.decode(None)]
    return frame.to_ndarray(format="rgb24")
