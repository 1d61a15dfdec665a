"""A stand-in for depthai's device half, as no device can be had: keeps what is asked and gives prepared pictures."""

from __future__ import annotations

from collections import deque
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import Any

import numpy as np


class Picture:
    """An ``ImgFrame`` or ``EncodedFrame``."""

    def __init__(self, values: Any, seconds: float, number: int = 0) -> None:
        self.values, self.seconds, self.number = values, seconds, number

    def getFrame(self) -> np.ndarray:
        return self.values

    def getData(self) -> np.ndarray:
        return np.frombuffer(self.values, np.uint8)

    def getTimestamp(self, offset: object) -> timedelta:
        assert offset == "middle"
        return timedelta(seconds=self.seconds)

    def getTimestampSystem(self, offset: object) -> datetime:
        return datetime.fromtimestamp(5000.0 + self.seconds, tz=UTC)

    def getSequenceNum(self) -> int:
        return self.number


class Queue:
    """A message queue that ends with an error, or with the pipeline."""

    def __init__(self, module: Any, items: list[Any]) -> None:
        self.module, self.items = module, deque(items)

    def tryGet(self) -> Any:
        if self.items:
            item = self.items.popleft()
            if isinstance(item, Exception):
                raise item
            return item
        self.module.running = not self.module.ends
        return None


class Asked:
    """Takes any call, keeps it, and gives itself, so that calls can be chained."""

    def __init__(self, kept: list[tuple[str, tuple, dict]], name: str) -> None:
        self._kept, self._name = kept, name

    def __getattr__(self, name: str) -> Asked:
        return Asked(self._kept, f"{self._name}.{name}")

    def __getitem__(self, name: str) -> Asked:
        return Asked(self._kept, f"{self._name}[{name}]")

    def __call__(self, *args: Any, **options: Any) -> Any:
        self._kept.append((self._name, args, options))
        if self._name.endswith("createOutputQueue"):
            return self._kept_queue()
        return self

    def _kept_queue(self) -> Any:
        return FakeDepthai.queue


class _Devices:
    """The class ``Device``: opens one, and lists them."""

    def __init__(self, module: FakeDepthai) -> None:
        self._module = module

    def __call__(self, info: str) -> Any:
        return self._module._device(info)

    def getAllAvailableDevices(self) -> list[Any]:
        return [SimpleNamespace(getDeviceId=lambda: "14442C10")] if self._module.there else []


class FakeDepthai:
    """The module; ``items`` are what its queue gives."""

    queue: Any = None
    __version__ = "3.12.0"

    def __init__(
        self, items: list[Any], *, sockets: tuple[str, ...] = ("b", "c"), flood: bool = True, roles: bool = True,
        there: bool = True, ends: bool = True,
    ) -> None:  # fmt: skip
        self.kept: list[tuple[str, tuple, dict]] = []
        self.running, self.ends, self.closed, self.there = True, ends, 0, there
        self.sockets, self.flood, self.roles = sockets, flood, roles
        FakeDepthai.queue = Queue(self, items)
        self.CameraBoardSocket = SimpleNamespace(CAM_A="a", CAM_B="b", CAM_C="c")
        self.CameraExposureOffset = SimpleNamespace(MIDDLE="middle")
        members = {"MASTER": "master", "SLAVE": "slave"}
        self.ExternalFrameSyncRole = SimpleNamespace(**members, __members__=members)
        self.CameraControl = SimpleNamespace(FrameSyncMode=SimpleNamespace(TIME_PTP="ptp"))
        self.ImgFrame = SimpleNamespace(Type=SimpleNamespace(GRAY8="gray8", NV12="nv12"))
        self.VideoEncoderProperties = SimpleNamespace(Profile=SimpleNamespace(MJPEG="mjpeg"))
        align = SimpleNamespace(RECTIFIED_LEFT="left")
        self.StereoDepthConfig = SimpleNamespace(AlgorithmControl=SimpleNamespace(DepthAlign=align))
        names = ("Camera", "StereoDepth", "Sync", "VideoEncoder")
        self.node = SimpleNamespace(**{name: name for name in names})
        self.Device = _Devices(self)

    def DeviceInfo(self, identifier: str) -> str:
        return identifier

    def _device(self, info: str) -> Any:
        if not self.there:
            raise RuntimeError("cannot find it")
        return SimpleNamespace(
            getConnectedCameras=lambda: list(self.sockets), getProductName=lambda: "OAK-1",
            setIrFloodLightIntensity=self._flood, close=self._close,
            setIrLaserDotProjectorIntensity=lambda v: self.kept.append(("dots", (v,), {})),
            setExternalFrameSyncRole=self._role, readCalibration=lambda: self,
        )  # fmt: skip

    def getCameraIntrinsics(self, socket: str, width: int, height: int) -> list[list[float]]:
        if socket not in self.sockets:
            raise RuntimeError("no such camera")
        return [[400.0, 0, width / 2], [0, 400.0, height / 2], [0, 0, 1]]

    def _flood(self, value: float) -> bool:
        self.kept.append(("flood", (value,), {}))
        return self.flood

    def _role(self, role: str) -> tuple[bool, str]:
        self.kept.append(("role", (role,), {}))
        return self.roles, "" if self.roles else "no such pin"

    def _close(self) -> None:
        self.closed += 1

    def Pipeline(self, device: Any) -> Any:
        return SimpleNamespace(
            create=lambda node: Asked(self.kept, node), start=lambda: None, isRunning=lambda: self.running,
            stop=self._stop,
        )  # fmt: skip

    def _stop(self) -> None:
        self.running = False
        self.closed += 1

    def asked(self, name: str) -> list[tuple]:
        """Return the arguments of every call of a name."""
        return [args for called, args, _ in self.kept if called.endswith(name)]
