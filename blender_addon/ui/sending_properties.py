"""Whether the poses of a run are also sent to another program, and where."""

from __future__ import annotations

from typing import Any

import bpy

from .._exchange.errors import CommandLineInvalid
from .._exchange.vmc.address import VMC, VmcAddress, read_address


class SendingProperties:
    """What a property group inherits to send poses."""

    __annotations__ = {
        "send": bpy.props.BoolProperty(
            name="Send", description="Also send every pose to another program by the VMC protocol"
        ),
        "send_to": bpy.props.StringProperty(
            name="Send To", default=str(VmcAddress()),
            description="Address of the other program: vmc://HOST:PORT; 127.0.0.1 is this machine",
        ),
    }  # fmt: skip


def sending_options(properties: Any) -> list[str]:
    """Return the options of a live run for what is chosen; nothing is sent unasked.

    Args:
        properties: a property group with ``SendingProperties``.

    Raises:
        CommandLineInvalid: the address is none, or is of another machine while Blender may not go online.
    """
    return ["--send", str(allowed_address(properties.send_to))] if properties.send else []


def allowed_address(text: str, schemes: tuple[str, ...] = (VMC,)) -> VmcAddress:
    """Return the address of a text, where Blender's preferences allow it.

    Args:
        text: the address.
        schemes: protocols that will do.

    Raises:
        CommandLineInvalid: it is none, or is of another machine while Blender may not go online.
    """
    address = read_address(text, schemes)
    if not address.is_local and not bpy.app.online_access:
        raise CommandLineInvalid(
            "This address is not this machine's alone, and Blender may not go online.", where=str(address),
            hint="Allow Online Access in the preferences (System), or use 127.0.0.1.",
        )  # fmt: skip
    return address
