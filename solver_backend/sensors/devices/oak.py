"""Read infrared, depth and colour images from OAK-D and OAK-4 cameras with depthai 3."""

from __future__ import annotations

import json
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import timedelta
from fractions import Fraction
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens, build_cameras
from solver_backend.exchange.errors import BackendMissing, CalibrationMissing, CommandLineInvalid, OutputNotWritable
from solver_backend.exchange.outputs import check_output, write_text
from solver_backend.sensors.devices.device import (
    Device,
    OpenedDevice,
    PicturesDiffer,
    SensorFailed,
    SensorFrame,
    SensorUnknown,
)
from solver_backend.types import Cameras
from solver_backend.videos.files.video import library
from solver_backend.videos.streaming.moments import LivePicture
from solver_backend.videos.sync.clocks import Clocks

LEAST_VERSION = 3  # Oldest supported major version of depthai.
QUIET = {"DEPTHAI_INSTALL_SIGNAL_HANDLER": "0", "DEPTHAI_LEVEL": "off"}
"""Settings that keep depthai from handling signals and from writing to standard output, which other programs read."""


def depthai() -> Any:
    """Import ``depthai`` version 3 or later, or raise ``BackendMissing``."""
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    try:
        module = import_module("depthai")
    except ImportError as error:
        message = "OAK cameras need the package depthai, which is not installed."
        raise BackendMissing(message, hint="Install it with `pip install depthai`.") from error
    version = str(module.__version__)
    if int(version.split(".")[0]) < LEAST_VERSION:
        hint = "Install it with `pip install --upgrade depthai`."
        raise BackendMissing(f"depthai {version} is installed, but {LEAST_VERSION} or later is needed.", hint=hint)
    return module


def listed_oaks() -> list[str]:
    """Return the sorted identifiers of all OAKs on USB or on the network."""
    return sorted(str(info.getDeviceId()) for info in depthai().Device.getAllAvailableDevices())


def open_oak(identifier: str, name: str) -> Any:
    """Connect to an OAK device. Raise ``SensorFailed`` if it is missing or in use."""
    dai = depthai()
    try:
        return dai.Device(dai.DeviceInfo(identifier))
    except RuntimeError as error:
        found = ", ".join(listed_oaks()) or "none"
        message = f"The OAK '{identifier}' cannot be opened: {error}."
        hint = f"Connected cameras: {found}. Another program may use it. On Linux, USB needs Luxonis' udev rule."
        raise SensorFailed(message, where=f"sensor {name}", hint=hint) from error


ROLES = ("master", "slave")  # Roles on the synchronisation wire.


@dataclass
class OakPipeline(OpenedDevice, ABC):
    """An OAK camera whose pipeline, built by a subclass, runs from ``open`` to ``close``."""

    name: str
    identifier: str  # Device identifier, IP address or USB port.
    _pipeline: Any = field(default=None, init=False, repr=False)
    _queue: Any = field(default=None, init=False, repr=False)

    @abstractmethod
    def _build(self, dai: Any, device: Any, pipeline: Any) -> Any:
        """Add the nodes to the pipeline, and return their output queue."""

    @abstractmethod
    def _role(self) -> str:
        """Return the camera's role on the synchronisation wire, from ``ROLES``. Any other text means no role."""

    def open(self) -> None:
        """Connect and start. Raise SensorFailed, or SensorUnknown if the device lacks cameras or lights."""
        if self._pipeline is not None:
            return
        dai, device = depthai(), open_oak(self.identifier, self.name)
        try:
            self._set_role(dai, device)
            pipeline = dai.Pipeline(device)
            self._queue = self._build(dai, device, pipeline)
            pipeline.start()
            self._pipeline = pipeline
        except BaseException:
            device.close()
            raise

    def _set_role(self, dai: Any, device: Any) -> None:
        if (role := self._role()) not in ROLES:
            return
        done, why = device.setExternalFrameSyncRole(getattr(dai.ExternalFrameSyncRole, role.upper()))
        if not done:
            message = f"The device cannot be {role} of the sync wire: {why}."
            hint = "Use models with an M8 plug or FSIN pins, or `--sync none` to synchronise the clocks with the wand."
            raise SensorFailed(message, where=f"sensor {self.name}", hint=hint)

    def _require_open(self) -> None:
        if self._pipeline is None:
            raise SensorFailed("The sensor is not open.", where=f"sensor {self.name}", hint="Open it first.")

    def close(self) -> None:
        """Stop the pipeline. This may be called several times."""
        pipeline, self._pipeline, self._queue = self._pipeline, None, None
        if pipeline is not None:
            pipeline.stop()


INFRARED, DEPTH = "infrared", "depth"
WAIT_S = 0.0005  # Seconds between checks of an empty queue.
LARGEST_JUMP_S = 10.0  # Largest forward step in seconds of an intact device clock. Backward steps also mean a reset.


def paired(
    dai: Any, pipeline: Any, infrared: Any, depth: Any, fps: float, queue: int, *, blocking: bool = False
) -> Any:
    """Return a queue of infrared and depth images that the host pairs by exposure time.

    Images more than half a frame apart come from different exposures. With ``blocking``, no pair is dropped, which
    suits recordings. Otherwise, a full queue drops its oldest pair.
    """
    sync = pipeline.create(dai.node.Sync)
    sync.setRunOnHost(True)
    sync.setSyncThreshold(timedelta(seconds=0.5 / fps))
    for name, output in ((INFRARED, infrared), (DEPTH, depth)):
        entry = sync.inputs[name]
        entry.setBlocking(blocking)
        entry.setMaxSize(queue)
        output.link(entry)
    return sync.out.createOutputQueue(maxSize=queue, blocking=blocking)


def paired_frames(
    dai: Any, name: str, queue: Any, running: Callable[[], bool], silent_s: float, by_ptp: bool = False
) -> Iterator[SensorFrame]:
    """Yield frames from a queue while ``running``. Without a frame for ``silent_s``, the device counts as lost.

    Raises:
        SensorFailed: the device was lost or sent nothing, or its clock was reset.
        PicturesDiffer: infrared and depth images have different sizes.
    """
    where, last_s, heard_s = f"sensor {name}", -np.inf, time.perf_counter()
    while True:
        try:
            pair = queue.tryGet()
        except Exception as error:  # depthai raises its own exception types
            if running():
                message, hint = f"The device was lost: {error}.", "Plug it in and open it again."
                raise SensorFailed(message, where=where, hint=hint) from error
            pair = None
        now_s = time.perf_counter()
        if pair is None:
            if not running():
                return
            if now_s - heard_s > silent_s:
                hint = "Check the cable, which must carry USB 3 or PoE. The others wait for the first camera's pulse."
                raise SensorFailed(f"No frame arrived for {silent_s:g} s.", where=where, hint=hint)
            time.sleep(WAIT_S)
            continue
        heard_s, infrared = now_s, pair[INFRARED]
        counts, mm = np.array(infrared.getFrame()), np.array(pair[DEPTH].getFrame())
        if counts.shape != mm.shape:
            message = (
                f"Infrared is {counts.shape[1]} x {counts.shape[0]} pixels, but depth is {mm.shape[1]} x {mm.shape[0]}."
            )
            hint = "Use one size for both, and align depth to the infrared image."
            raise PicturesDiffer(message, where=where, hint=hint)
        device_s = _exposure_s(dai, infrared, by_ptp, where)
        if np.isfinite(last_s) and not 0.0 < device_s - last_s < LARGEST_JUMP_S:
            message = f"The device's clock jumped from {last_s:.3f} to {device_s:.3f} s."
            raise SensorFailed(message, where=where, hint="The device restarted. Open it again.")
        last_s = device_s
        number = int(infrared.getSequenceNum())
        yield SensorFrame(name, counts, mm.astype(np.uint16, copy=False), device_s, now_s, number)


def _exposure_s(dai: Any, picture: Any, by_ptp: bool, where: str) -> float:
    """Return the centre of the exposure in seconds, on the PTP clock if ``by_ptp``, otherwise on the host's clock."""
    middle = dai.CameraExposureOffset.MIDDLE
    if not by_ptp:
        return float(picture.getTimestamp(middle).total_seconds())
    stamp = picture.getTimestampSystem(middle)
    if stamp is None:
        hint = "PTP needs an OAK-4 on Ethernet. Use `--sync wire` for other models."
        raise SensorFailed("The clock of the device does not support PTP.", where=where, hint=hint)
    return float(stamp.timestamp())


SYNCS = ("none", "master", "slave", "ptp")
"""Synchronisation: none, pulses sent or received by wire (M8 or FSIN), or network clock (OAK-4 on Ethernet)."""
SIZES = ((640, 400), (1280, 800))  # Possible image sizes of the mono cameras in pixels.


@dataclass(frozen=True)
class OakSettings:
    """Settings for an OAK with two mono cameras and an infrared flood light."""

    fps: float = 60.0  # Frame rate in 1/s. With depth, 640 x 400 reaches 60, and 1280 x 800 about 30.
    size: tuple[int, int] = (640, 400)  # Width and height of infrared and depth images in pixels.
    exposure_us: int = 800  # Exposure time in microseconds. In 800 µs, a hand at 5 m/s moves 4 mm.
    iso: int = 200  # Sensitivity. A low value keeps everything but reflectors dark.
    flood: float = 1.0  # Strength of the infrared flood light, 0 to 1. Retro-reflective markers need it.
    sync: str = "none"  # One of ``SYNCS``.
    silent_s: float = 5.0  # Seconds without a frame until the device counts as lost.
    queue: int = 4  # Maximum number of frames that wait for the host. Then the oldest one is dropped.

    def __post_init__(self) -> None:
        if self.sync not in SYNCS:
            message = f"Unknown synchronisation '{self.sync}'."
            raise CommandLineInvalid(message, hint=f"Choose one of {', '.join(SYNCS)}.")
        if tuple(self.size) not in SIZES:
            message = f"Images of {self.size} are not possible with an OAK's mono cameras."
            raise CommandLineInvalid(message, hint=f"Choose one of {', '.join(f'{w} x {h}' for w, h in SIZES)}.")
        if not (0 < self.fps <= 120 and 0.0 <= self.flood <= 1.0 and 100 <= self.iso <= 1600):
            message = f"{self.fps:g} frames per second, flood {self.flood} and ISO {self.iso} are not valid together."
            raise CommandLineInvalid(message, hint="Use up to 120 frames per second, flood 0 to 1 and ISO 100 to 1600.")
        if not 20 <= self.exposure_us <= 0.9e6 / self.fps:
            longest = f"{0.9e6 / self.fps:.0f} microseconds at {self.fps:g} frames per second"
            message = f"The exposure must be 20 to {longest}, not {self.exposure_us}."
            raise CommandLineInvalid(message, hint="500 to 1500 microseconds keep a moving marker sharp.")


@dataclass
class Oak(OakPipeline, Device):
    """The stereo cameras of an OAK. Infrared and depth are aligned with the left image."""

    settings: OakSettings = field(default_factory=OakSettings)

    def _role(self) -> str:
        return self.settings.sync

    def _build(self, dai: Any, device: Any, pipeline: Any) -> Any:
        self._require_stereo(dai, device)
        self._set_light(device)
        return paired(dai, pipeline, *self._cameras(dai, pipeline), self.settings.fps, self.settings.queue)

    def frames(self) -> Iterator[SensorFrame]:
        """Yield frames until the device is closed. Raises the errors of ``paired_frames``."""
        self._require_open()
        running, by_ptp = self._pipeline.isRunning, self.settings.sync == "ptp"
        yield from paired_frames(depthai(), self.name, self._queue, running, self.settings.silent_s, by_ptp)

    def _require_stereo(self, dai: Any, device: Any) -> None:
        sockets = device.getConnectedCameras()
        if dai.CameraBoardSocket.CAM_B not in sockets or dai.CameraBoardSocket.CAM_C not in sockets:
            message = f"{device.getProductName()} has no pair of mono cameras for infrared and depth."
            hint = "Use an OAK-D Pro (USB or PoE) or OAK-4 D Pro, which also has a flood light."
            raise SensorUnknown(message, where=f"sensor {self.name}", hint=hint)

    def _set_light(self, device: Any) -> None:
        settings = self.settings
        if not device.setIrFloodLightIntensity(settings.flood) and settings.flood > 0:
            message = f"{device.getProductName()} has no infrared light to illuminate the markers."
            hint = "Use a Pro model, or a ring of infrared lights with --flood 0."
            raise SensorUnknown(message, where=f"sensor {self.name}", hint=hint)
        # The dots could be mistaken for markers.
        device.setIrLaserDotProjectorIntensity(0.0)

    def _cameras(self, dai: Any, pipeline: Any) -> tuple[Any, Any]:
        settings, outputs = self.settings, []
        for socket in (dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C):
            camera = pipeline.create(dai.node.Camera).build(socket, sensorFps=settings.fps)
            camera.initialControl.setManualExposure(settings.exposure_us, settings.iso)
            if settings.sync == "ptp":
                camera.initialControl.setFrameSyncMode(dai.CameraControl.FrameSyncMode.TIME_PTP)
            outputs.append(camera.requestOutput(settings.size, dai.ImgFrame.Type.GRAY8, fps=settings.fps))
        stereo = pipeline.create(dai.node.StereoDepth).build(*outputs)
        stereo.setDepthAlign(dai.StereoDepthConfig.AlgorithmControl.DepthAlign.RECTIFIED_LEFT)
        stereo.setLeftRightCheck(True)
        stereo.setSubpixel(True)
        return stereo.rectifiedLeft, stereo.depth


def oak_cameras(oaks: Sequence[Oak]) -> Cameras:
    """Return the rectified left cameras with their factory lenses. Unknown poses are set to the identity.

    Raises:
        SensorFailed, CalibrationMissing: a device is missing or not calibrated.
    """
    dai = depthai()
    K = [_intrinsics(dai, oak) for oak in oaks]
    lenses = [Lens(of_oak, np.zeros(8), oak.settings.size) for of_oak, oak in zip(K, oaks, strict=True)]
    still = np.tile(np.eye(3), (len(oaks), 1, 1)), np.zeros((len(oaks), 3))
    return build_cameras([oak.name for oak in oaks], lenses, *still)


def _intrinsics(dai: Any, oak: Oak) -> np.ndarray:
    device = open_oak(oak.identifier, oak.name)
    try:
        found = device.readCalibration().getCameraIntrinsics(dai.CameraBoardSocket.CAM_B, *oak.settings.size)
    except RuntimeError as error:
        message = f"The device has no factory calibration: {error}."
        hint = "Film a board in infrared, and specify --calibration."
        raise CalibrationMissing(message, where=f"sensor {oak.name}", hint=hint) from error
    finally:
        device.close()
    return np.array(found, dtype=np.float64)


KINDS = ("oak",)


def device_named(text: str, settings: OakSettings = OakSettings()) -> Oak:
    """Parse ``oak:ID`` or ``oak:ID=NAME``. The device is not opened.

    Raises:
        SensorUnknown: the type is unknown, or the identifier is missing.
    """
    kind, _, rest = text.partition(":")
    identifier, _, name = rest.partition("=")
    if kind.lower() not in KINDS:
        hint = f"Known kinds: {', '.join(KINDS)}. Write oak:IDENTIFIER=NAME. `sensors list` shows the identifiers."
        raise SensorUnknown(f"There is no kind of sensor '{kind}'.", where=text, hint=hint)
    if not identifier:
        hint = "`sensors list` lists the identifiers."
        raise SensorUnknown("The sensor's identifier is missing.", where=text, hint=hint)
    return Oak(name or identifier, identifier, settings)


TICKS = 90_000  # Ticks per second of a video file's clock.
PICTURE_WAIT_S = 0.001  # Seconds between checks of an empty queue.
CLOCKS = "clocks.json"  # File that stores the clocks of the videos, see ``Clocks``.


@dataclass(frozen=True)
class ColourPicture:
    """A JPEG image from a colour camera."""

    jpeg: bytes
    time_s: float  # Centre of the exposure in seconds on the clock that all cameras share.


class ColourSource(Protocol):
    """A camera that delivers compressed images, such as ``OakColour``."""

    name: str
    size: tuple[int, int]
    fps: float

    def open(self) -> None:
        """Connect and start."""
        ...

    def pictures(self) -> Iterator[ColourPicture | None]:
        """Yield images as they arrive, and None while no image is available, until the device ends."""
        ...

    def close(self) -> None:
        """Stop the camera."""
        ...


@dataclass
class OakColour(OakPipeline):
    """The colour camera of an OAK, which compresses every image separately (MJPEG)."""

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
        """Yield images, and None while no image is available. Raise ``SensorFailed`` if the device is lost."""
        self._require_open()
        middle = depthai().CameraExposureOffset.MIDDLE
        while self._pipeline is not None and self._pipeline.isRunning():
            try:
                found = self._queue.tryGet()
            except Exception as error:  # depthai raises its own exception types
                raise SensorFailed(f"The device was lost: {error}.", where=f"sensor {self.name}") from error
            yield found and ColourPicture(bytes(found.getData()), found.getTimestamp(middle).total_seconds())


class ColourFile:
    """A fragmented MP4 file, which stays readable if the recording is interrupted.

    The file stores the time of each image relative to ``begin_s`` on the shared clock. ``fps`` is only the nominal
    rate.
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
        """Append an image that is later than the last one. Raise ``OutputNotWritable`` if that fails."""
        at = round((picture.time_s - self.begin_s) * TICKS)
        if at <= self._last or at < 0:
            return
        packet = self._av.Packet(picture.jpeg)
        packet.pts = packet.dts = at
        packet.time_base, packet.stream, packet.is_keyframe = Fraction(1, TICKS), self._stream, True
        try:
            self._container.mux(packet)
        except OSError as error:
            message = f"The video cannot be continued: {error.strerror}."
            hint = "Check the free space on the disk. The frames so far can be used."
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
    """Write ``NAME.mp4`` for each camera, starting at the first common exposure. Return frame counts.

    Raises:
        OutputExists: a video already exists.
        OutputNotWritable: the disk is full.
        SensorFailed: a camera was lost or delivered no images.
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
        time.sleep(PICTURE_WAIT_S)
    raise SensorFailed(
        "The camera is not sending images.",
        where=f"sensor {name}",
        hint="Start the camera that sends the sync pulse first.",
    )


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
            time.sleep(PICTURE_WAIT_S)


class OakPictures:
    """Live images from a colour camera, with exposure times on a clock that devices and host share."""

    def __init__(self, camera: ColourSource) -> None:
        self._camera = camera
        self.name, self.size, self.fps = camera.name, camera.size, camera.fps

    def open(self) -> None:
        """Connect to the camera."""
        self._camera.open()

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield images with times relative to ``start``. Raise ``SensorFailed`` if the device is lost."""
        number = 0
        for picture in self._camera.pictures():
            if picture is None:
                time.sleep(PICTURE_WAIT_S)
                continue
            arrived = time.perf_counter()
            yield LivePicture(number, picture.time_s - start, arrived, partial(_decoded, picture.jpeg))
            number += 1

    def close(self) -> None:
        """Disconnect from the camera."""
        self._camera.close()


def _decoded(jpeg: bytes) -> np.ndarray:
    """Decode a JPEG file to an (H, W, 3) RGB image."""
    codec: Any = library().CodecContext.create("mjpeg", "r")
    [frame, *_] = [*codec.decode(library().Packet(jpeg)), *codec.decode(None)]
    return frame.to_ndarray(format="rgb24")
