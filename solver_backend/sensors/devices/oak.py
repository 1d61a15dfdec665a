"""OAK-D and OAK-4 cameras over depthai 3: infrared under a flood light, and stereo depth on its pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from solver_backend.sensors.devices.device import OpenedDevice, SensorFrame
from solver_backend.sensors.devices.oak_module import depthai, open_oak, set_sync_role
from solver_backend.sensors.devices.oak_settings import OakSettings
from solver_backend.sensors.devices.oak_stream import PairStream, paired
from solver_backend.sensors.errors import SensorFailed, SensorUnknown


@dataclass
class Oak(OpenedDevice):
    """One OAK; its infrared picture is the rectified left one, to whose pixels depth is aligned."""

    name: str
    """The sensor's name, as in the calibration."""
    identifier: str
    """The device's identifier, IP address or USB port."""
    settings: OakSettings = field(default_factory=OakSettings)
    """How it is set."""
    _pipeline: Any = field(default=None, init=False, repr=False)
    _stream: PairStream | None = field(default=None, init=False, repr=False)

    def open(self) -> None:
        """Connect, fix exposure and flood, and start.

        Raises:
            BackendMissing: depthai is not installed.
            SensorFailed: the device is not there, in use, or refuses a setting.
            SensorUnknown: it has no pair of mono cameras.
        """
        dai, settings = depthai(), self.settings
        if self._stream is not None:
            return
        device = open_oak(self.identifier, self.name)
        try:
            pipeline = dai.Pipeline(device)
            self._require_stereo(dai, device)
            self._set_light(device)
            set_sync_role(device, settings.sync, self.name)
            infrared, depth = self._cameras(dai, pipeline)
            queue = paired(dai, pipeline, infrared, depth, settings.fps, settings.queue)
            pipeline.start()
        except BaseException:
            device.close()
            raise
        self._pipeline = pipeline
        self._stream = PairStream(
            dai, self.name, queue, lambda: bool(pipeline.isRunning()), settings.silent_s, settings.sync == "ptp"
        )

    def frames(self) -> Iterator[SensorFrame]:
        """Yield frames until the device is closed.

        Raises:
            SensorFailed: it is not open, went away, fell silent, or its clock jumped.
            PicturesDiffer: infrared and depth are of different sizes.
        """
        if self._stream is None:
            raise SensorFailed("The sensor is not open.", where=f"sensor {self.name}", hint="Open it first.")
        yield from self._stream.frames()

    def close(self) -> None:
        """End; may be called several times."""
        pipeline, self._pipeline, self._stream = self._pipeline, None, None
        if pipeline is not None:
            pipeline.stop()

    def _require_stereo(self, dai: Any, device: Any) -> None:
        sockets = device.getConnectedCameras()
        if dai.CameraBoardSocket.CAM_B not in sockets or dai.CameraBoardSocket.CAM_C not in sockets:
            raise SensorUnknown(
                f"{device.getProductName()} has no pair of mono cameras for infrared and depth.",
                where=f"sensor {self.name}", hint="An OAK-D Pro (USB or PoE) or OAK-4 D Pro has, and the flood light.",
            )  # fmt: skip

    def _set_light(self, device: Any) -> None:
        settings = self.settings
        if not device.setIrFloodLightIntensity(settings.flood) and settings.flood > 0:
            raise SensorUnknown(
                f"{device.getProductName()} has no infrared flood light, without which markers stay dark.",
                where=f"sensor {self.name}", hint="Use a Pro model, or a ring of infrared lights with --flood 0.",
            )  # fmt: skip
        # Its dots would be taken for markers.
        device.setIrLaserDotProjectorIntensity(0.0)

    def _cameras(self, dai: Any, pipeline: Any) -> tuple[Any, Any]:
        """Return the outputs of rectified infrared and of depth on its pixels."""
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
