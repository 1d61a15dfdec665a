"""depthai where an OAK is asked for, and OAKs opened by it, with named errors where it or they are not there."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

from solver_backend.exchange.errors import BackendMissing
from solver_backend.sensors.errors import SensorFailed

LEAST_VERSION = 3
QUIET = {"DEPTHAI_INSTALL_SIGNAL_HANDLER": "0", "DEPTHAI_LEVEL": "off"}
"""Else it takes over the process' signals, of a full disk too, and writes among the lines on standard output that
programs read; what matters comes as exceptions."""


def depthai() -> Any:
    """Return the module ``depthai``.

    Raises:
        BackendMissing: it is not installed, or of a version before 3; it belongs to the extra ``oak``.
    """
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    try:
        module = import_module("depthai")
    except ImportError as error:
        raise BackendMissing(
            "OAK cameras are read by depthai, which is not installed.",
            hint="Install it with: pip install depthai.",
        ) from error
    version = str(module.__version__)
    if int(version.split(".")[0]) < LEAST_VERSION:
        raise BackendMissing(
            f"depthai {version} is installed; {LEAST_VERSION} or later is needed.",
            hint="Install it with: pip install --upgrade depthai.",
        )
    return module


def listed_oaks() -> list[str]:
    """Return the identifiers of the OAKs that are plugged in or on the network, sorted.

    Raises:
        BackendMissing: depthai is not installed.
    """
    return sorted(str(info.getDeviceId()) for info in depthai().Device.getAllAvailableDevices())


def open_oak(identifier: str, name: str) -> Any:
    """Return a device that is connected.

    Args:
        identifier: of the device, its IP address or its USB port.
        name: of the sensor, for errors.

    Raises:
        BackendMissing: depthai is not installed.
        SensorFailed: the device is not there, or in use.
    """
    dai = depthai()
    try:
        return dai.Device(dai.DeviceInfo(identifier))
    except RuntimeError as error:
        found = ", ".join(listed_oaks()) or "none"
        raise SensorFailed(
            f"The OAK '{identifier}' cannot be opened: {error}.", where=f"sensor {name}",
            hint=f"Found are: {found}. Another program may use it; on Linux USB needs Luxonis' udev rule.",
        ) from error  # fmt: skip


def set_sync_role(device: Any, role: str, name: str) -> None:
    """Let a device lead or follow on the sync wire, if it is to do either.

    Args:
        device: an open one.
        role: 'master' or 'slave'; any other name is none of the wire's.
        name: of the sensor, for errors.

    Raises:
        SensorFailed: the device cannot.
    """
    roles = depthai().ExternalFrameSyncRole
    known = {"master": roles.MASTER, "slave": roles.SLAVE}
    if role not in known:
        return
    done, why = device.setExternalFrameSyncRole(known[role])
    if not done:
        raise SensorFailed(
            f"The device cannot be {role} of the sync wire: {why}.", where=f"sensor {name}",
            hint="Models with an M8 plug or FSIN pins can; else use sync none: the wand synchronises the clocks.",
        )  # fmt: skip
