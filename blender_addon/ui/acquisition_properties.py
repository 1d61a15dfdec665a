"""Settings of the Acquire tab: live capture, the sensor array, and the studio."""

from __future__ import annotations

from typing import Any

import bpy

from .._exchange.errors import CommandLineInvalid
from .._exchange.solve_settings import METHODS
from .._exchange.vmc.sender import SENT, VMC, VmcAddress, read_address
from ..conventions.file_paths import file_of
from .setting_properties import Items, choice, flags, items_of, number, path, switch, text

_SUBJECT = "Person file from Calibrate Subject (leave blank to learn the body shape while the person moves)"


class SendingProperties:
    """Mixin for the settings of runs that can send their poses to other programs."""

    send: switch("Send", "Stream every pose to another program with the VMC protocol")
    send_to: text(
        "Send To",
        "Address of the receiving program (keep the default if it runs on this computer)",
        str(VmcAddress()),
    )


class MocapLive(SendingProperties, bpy.types.PropertyGroup):
    """Settings of the Live panel."""

    kind: choice("Source", "Recording, program or cameras that provide the live motion", "live.kind")
    source: path(
        "Recording",
        "Marker recording (C3D, TRC, CSV, TSV) or motion (.npz) to replay (leave blank to use the capture's markers)",
    )
    listen: text(
        "Listen At",
        "Where the data arrives (vmc://0.0.0.0 to receive from other computers, livelink://0.0.0.0 or "
        "ifacialmocap://PHONE to receive a face)",
        str(VmcAddress()),
    )
    cameras: text(
        "Cameras",
        "Two to four cameras, such as webcam:0 oak:ID or video files (left=webcam:0 assigns a webcam to the calibrated "
        "camera 'left')",
    )
    calibration: path("Calibration", "File with the positions and lenses of the cameras above")
    subject: path("Subject", _SUBJECT)
    record: switch("Record", "Save the received points or poses to a file, to solve or import them later", on=True)
    drive: switch("Drive Character", "Also move the character chosen as target in the Retarget panel")
    face_mesh: text("Face", "Character mesh that shows the received expressions with its shape keys")
    face_table: path("Face Table", "JSON file that maps each channel to a shape key (leave blank if the names match)")


def sending_options(properties: Any) -> list[str]:
    """Return the command-line options for sending live poses, or an empty list if sending is off."""
    return ["--send", str(allowed_address(properties.send_to, SENT))] if properties.send else []


def allowed_address(text: str, schemes: tuple[str, ...] = (VMC,)) -> VmcAddress:
    """Parse a network address. Reject other computers if Blender's online access is off."""
    address = read_address(text, schemes)
    if not address.is_local and not bpy.app.online_access:
        hint = "Allow Online Access in the preferences (System), or use 127.0.0.1."
        message = "This address is on another computer, but online access is disabled in Blender."
        raise CommandLineInvalid(message, where=str(address), hint=hint)
    return address


PARTS = {
    "WAND": ("Wave the Wand", "Record the wand, and show which parts of each image it has not reached yet", "wand"),
    "GAMMA": ("Film the Γ", "Record the three floor markers that define the origin and the up axis", "gamma"),
    "TAKE": ("Start", "Show the points and a body live, and record them", "take"),
}
"""Label, description and property of each kind of sensor run."""
GAMMA_S = 5.0  # Recording time of the Γ in seconds.


class MocapSensors(SendingProperties, bpy.types.PropertyGroup):
    """Settings and recordings of the sensor array."""

    kind: choice("Sensors", "Source of the images: connected cameras or a recording", "sensors.kind")
    source: path("Recording", "Folder with infrared and depth images from several sensors", folder=True)
    oaks: text(
        "Cameras", "IDs with optional names (ID=front ID=left), starting with the camera that drives the sync wire"
    )
    sync: choice("Sync", "Signal that makes all cameras expose at the same time", "sensors.sync")
    calibration: path("Calibration", "Sensor calibration (leave blank to use the recording's calibration)")
    wand: path("Wand", "Recording of a single marker that was waved through the capture volume", folder=True)
    gamma: path("Γ", "Recording of three floor markers (leave blank to use the first sensor as origin)", folder=True)
    long_edge: number(
        "Long Edge", "Distance between the marker centres along the longer side of the Γ", 0.6, 0.05, 5, "m"
    )
    short_edge: number(
        "Short Edge", "Distance between the marker centres along the shorter side of the Γ", 0.4, 0.05, 5, "m"
    )
    trigger: switch("One Trigger", "Enable if one signal triggers all sensors, so that no time offset is estimated")
    subject: path("Subject", _SUBJECT)
    record: switch("Record", "Save the sensor images for a later solve (90 MB per second per sensor)", on=True)
    take: path("Take", "Sensor recording to import as a capture", folder=True)
    findings: str  # Calibration results, one sentence per line.

    def sensors(self) -> list[str]:
        """Return the sensors as command-line arguments, or an empty list if the user has not chosen any."""
        calibration = _paths("--calibration", self.calibration)
        if self.kind == "FOLDER":
            return [*_paths(self.source), *calibration] if self.source else []
        named = [part for oak in self.oaks.split() for part in ("--oak", oak)]
        return [*named, "--sync", self.sync, *calibration] if named else []

    def calibrating(self) -> list[str]:
        """Return the command-line options of the wand calibration."""
        options = [*_paths(self.wand), *(["--trigger"] if self.trigger else [])]
        lengths = ["--gamma-lengths", f"{self.long_edge:.4f}", f"{self.short_edge:.4f}"]
        return [*options, *_paths("--gamma", self.gamma), *lengths] if self.gamma else options


def _paths(*words: str) -> list[str]:
    return [*words[:-1], str(file_of(words[-1]))] if words[-1] else []


OWN = "OWN"
PRESET_ARRAYS = items_of("studio.against")
FAULTS = items_of("studio.faults")
_METHODS = (("triangulation", "Triangulation", "Triangulated keypoints without a body model"), *METHODS)


def _forget_plan(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    self.planned = ""


_PLAN: dict[str, Any] = {"update": _forget_plan}


class MocapBenchmarkRow(bpy.types.PropertyGroup):
    """Accuracy of one camera array in the benchmark table."""

    array: str
    faults: str  # Description of the simulated errors.
    reached: str  # Mean joint error of each method.
    median_mm: float  # Median error of keypoints triangulated on the floor, or -1 if none could be triangulated.
    page: str
    places: str  # File that stores the error at each floor position.


class MocapStudio(bpy.types.PropertyGroup):
    """Settings of the Studio panels, which make data sets and benchmarks."""

    motion: choice("Motion", "Motion that the simulated people perform", "studio.motion", **_PLAN)
    motion_path: path("Path", "Motion file, or a folder with several motion files", **_PLAN)
    frames: number("Frames", "Maximum number of frames per shot", 60, 1, 100_000, **_PLAN)
    fps: number("Rate", "Images per second from each camera", 30.0, 1, 1000, **_PLAN)
    people: number("People", "Number of different bodies, each filmed alone", 1, 1, 1000, **_PLAN)
    strange: switch("Unusual Proportions", "Use bodies that the solver's body model cannot match exactly", **_PLAN)
    seed: number("Seed", "Change this number for other people, clothes and errors", 0, 0, 2**31 - 1, **_PLAN)
    array: choice(
        "Camera Array",
        "Positions and lenses of the simulated cameras",
        (*items_of("studio.array"), *PRESET_ARRAYS),
        **_PLAN,
    )
    count: number("Cameras", "Number of cameras in the ring", 4, 1, 64, **_PLAN)
    radius_m: number("Radius", "Distance from the centre of the ring", 3.0, 0.2, 50, "m", **_PLAN)
    height_m: number("Height", "Height of the lenses above the floor", 1.4, 0, 20, "m", **_PLAN)
    look: choice("Look", "Clothing, furniture and light in the images", "studio.look", **_PLAN)
    film: flags("Film", "Images that each camera records", "studio.film", "infrared", "depth", "masks", **_PLAN)
    write: flags("Write", "Additional files for other programs", "studio.write", **_PLAN)
    faults: choice("Faults", "Errors added to the simulated detections or markers", FAULTS, **_PLAN)
    engine: choice("Engine", "Blender render engine for the colour images", "studio.engine", **_PLAN)
    scale: number(
        "Image Scale", "Factor for width and height, such as 0.5 for a quarter of the pixels", 1.0, 0.05, 4, **_PLAN
    )
    out: path("Folder", "Data set folder (leave blank to create one next to the takes)", folder=True, **_PLAN)
    methods: flags("Methods", "Solver methods to compare on the simulated take", _METHODS, "triangulation", "global")
    against: flags("Compare With", "Other camera arrays to test with the same motion", PRESET_ARRAYS)
    fewer: switch("One Camera Fewer", "Also test the array without its last camera, to see how much this camera helps")
    planned: str  # Size of the checked data set, or "" once a setting has changed.
    planned_file: str
    planned_out: str
    rows: Items[MocapBenchmarkRow]
    shown_mm: bpy.props.FloatVectorProperty(size=2)  # Errors at the two ends of the map's colour scale.
