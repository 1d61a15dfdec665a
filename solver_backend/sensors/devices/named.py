"""A device by what is typed on a command line: its kind, its identifier, the sensor's name."""

from __future__ import annotations

from solver_backend.sensors.devices.oak import Oak
from solver_backend.sensors.devices.oak_settings import OakSettings
from solver_backend.sensors.errors import SensorUnknown

KINDS = ("oak",)


def device_named(text: str, settings: OakSettings = OakSettings()) -> Oak:
    """Return the device of ``KIND:IDENTIFIER`` or ``KIND:IDENTIFIER=NAME``, closed.

    The name is the identifier if left out.

    Args:
        text: such as ``oak:192.168.1.20=left``.
        settings: of OAKs.

    Raises:
        SensorUnknown: the kind is not known, or no identifier is given.
    """
    kind, _, rest = text.partition(":")
    identifier, _, name = rest.partition("=")
    if kind.lower() not in KINDS:
        raise SensorUnknown(
            f"There is no kind of sensor '{kind}'.", where=text,
            hint=f"There are {', '.join(KINDS)}: write oak:IDENTIFIER=NAME, see the verb oaks.",
        )  # fmt: skip
    if not identifier:
        raise SensorUnknown("The sensor's identifier is missing.", where=text, hint="The verb oaks lists them.")
    return Oak(name or identifier, identifier, settings)
