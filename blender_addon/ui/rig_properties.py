"""What the add-on keeps about an array of infrared and depth sensors."""

from __future__ import annotations

import bpy

from .locations import RELATIVE
from .sending_properties import SendingProperties

_KIND_ITEMS = (
    ("FOLDER", "Recording", "A folder that sensors were recorded to, or a shot of the studio, played at its own rate"),
    ("OAK", "OAK Cameras", "OAK-D Pro or OAK-4 D Pro cameras, by USB or network"),
)
_SYNC_ITEMS = (
    ("none", "None", "Cameras run freely; the wand synchronises them"),
    ("wire", "Wire", "A sync wire joins them; the first camera gives the pulse"),
    ("ptp", "PTP", "The network synchronises their clocks (OAK-4)"),
)
PARTS = {
    "WAND": ("Wave the Wand", "Show what of every picture the wand has visited and where to wave it next", "wand"),
    "GAMMA": ("Film the Γ", "Film the three markers on the floor that show where up and the origin are", "gamma"),
    "TAKE": ("Start", "Show points and a moving body while sensors see them, and record them", "take"),
}
"""Name, description and property of what a run of the sensors is for."""
GAMMA_S = 5.0
"""Seconds that the Γ is filmed for."""


class MocapRig(SendingProperties, bpy.types.PropertyGroup):
    """Sensors, their calibration, and what was recorded with them."""

    kind: bpy.props.EnumProperty(name="Sensors", description="Where pictures come from", items=_KIND_ITEMS)
    source: bpy.props.StringProperty(
        name="Recording", subtype="DIR_PATH", options=RELATIVE,
        description="Folder of infrared and depth pictures of several sensors",
    )  # fmt: skip
    oaks: bpy.props.StringProperty(
        name="Cameras", description="Identifiers of the cameras, each perhaps with a name: ID=front ID=left; "
        "the first gives the pulse of a sync wire",
    )  # fmt: skip
    sync: bpy.props.EnumProperty(name="Sync", description="How the cameras are synchronised", items=_SYNC_ITEMS)
    calibration: bpy.props.StringProperty(
        name="Calibration", subtype="FILE_PATH", options=RELATIVE,
        description="Where the sensors stand; empty for the recording's own, or for the lenses of the cameras alone",
    )  # fmt: skip
    wand: bpy.props.StringProperty(
        name="Wand", subtype="DIR_PATH", options=RELATIVE, description="Recording of a single marker that was waved"
    )
    gamma: bpy.props.StringProperty(
        name="Γ", subtype="DIR_PATH", options=RELATIVE,
        description="Recording of three markers on the floor; empty to leave the world where the first sensor is",
    )  # fmt: skip
    long_edge: bpy.props.FloatProperty(
        name="Long Edge", description="Of the Γ, from middle to middle", unit="LENGTH", default=0.6, min=0.05, max=5.0,
        precision=3,
    )  # fmt: skip
    short_edge: bpy.props.FloatProperty(
        name="Short Edge", description="Of the Γ, from middle to middle", unit="LENGTH", default=0.4, min=0.05, max=5.0,
        precision=3,
    )  # fmt: skip
    trigger: bpy.props.BoolProperty(
        name="One Trigger", description="All sensors expose by one signal: their clocks need not be found"
    )
    subject: bpy.props.StringProperty(
        name="Subject", subtype="FILE_PATH", options=RELATIVE,
        description="Calibrated person who wears the markers; empty to learn the shape while they move",
    )  # fmt: skip
    record: bpy.props.BoolProperty(
        name="Record", description="Keep the sensors' pictures, 90 MB a second for each, to be solved afterwards",
        default=True,
    )  # fmt: skip
    take: bpy.props.StringProperty(
        name="Take", subtype="DIR_PATH", options=RELATIVE, description="The sensors' recording that is to be solved"
    )
    said: bpy.props.StringProperty(name="Findings", description="What the calibration found, a sentence a line")

    def sensors(self) -> list[str]:
        """Return how a command line names the sensors; empty where there are none yet."""
        from ..conventions.file_paths import file_of

        calibration = ["--calibration", str(file_of(self.calibration))] if self.calibration else []
        if self.kind == "FOLDER":
            return [str(file_of(self.source)), *calibration] if self.source else []
        named = [part for oak in self.oaks.split() for part in ("--oak", oak)]
        return [*named, "--sync", self.sync, *calibration] if named else []

    def calibrating(self) -> list[str]:
        """Return the options of the wand's calibration."""
        from ..conventions.file_paths import file_of

        options = [str(file_of(self.wand)), *(["--trigger"] if self.trigger else [])]
        if not self.gamma:
            return options
        lengths = ["--gamma-lengths", f"{self.long_edge:.4f}", f"{self.short_edge:.4f}"]
        return [*options, "--gamma", str(file_of(self.gamma)), *lengths]


RIG_CLASSES = (MocapRig,)
"""In the order of registration."""
