"""Whether the poses of a run are also sent to another program, and where."""

from __future__ import annotations

from typing import Any

import bpy

from .._exchange.errors import CommandLineInvalid
from .._exchange.solve_settings import METHODS
from .._exchange.vmc.address import VMC, VmcAddress, read_address
from .project_files import RELATIVE


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


OWN = "OWN"
PRESET_ARRAYS = (
    ("webcam_ring_4", "Four Webcams", "Four common webcams on tripods around a room"),
    ("oak_d_4", "Four OAK-D", "Four OAK-D, their global-shutter mono cameras binned to 640 x 400"),
    ("azure_kinect_3", "Three Azure Kinects", "Three Azure Kinects at 2 m, depth in the near field of view"),
    ("vicon_12", "Twelve Optical", "Twelve optical cameras of 1.3 megapixels under the ceiling"),
)
_ARRAYS = (
    (OWN, "My Cameras", "The active capture's cameras, or the scene's where there is no capture"),
    ("SCENE", "Scene's Cameras", "All cameras of the scene that are shown, as they stand now"),
    ("RING", "A Ring", "As many like cameras as below, around the person"),
    *PRESET_ARRAYS,
)
_MOTIONS = (
    ("CHOREOGRAPHY", "Choreography", "Walking, reaching, turning and crouching: the motion that ships"),
    ("TAKE", "The Solved Take", "The take that the body plays"),
    ("FILE", "File or Folder", "A motion file, AMASS (.npz), BVH, or a folder of them"),
)
_LOOKS = (
    ("suit", "Suit", "A tight suit, on which markers are worn"),
    ("bare", "Bare", "No clothes and no hair: the body alone, with markers"),
    ("everyday", "Everyday", "Clothes and hair that are drawn, and two pieces of furniture"),
    ("cluttered", "Cluttered", "The same with five pieces of furniture in the way"),
    ("night", "Night", "Everyday in a dark room: colour pictures are dim and noisy"),
    ("varied", "Varied", "Clothes, hair and light are drawn, with three pieces of furniture"),
)
_FILM = (
    ("infrared", "Infrared", "Retro-reflective markers lit from the camera, 16 bit"),
    ("depth", "Depth", "Millimetres, with a time-of-flight sensor's faults"),
    ("masks", "Masks", "What each pixel shows"),
    ("normals", "Normals", "Which way each pixel's surface looks"),
    ("rgb", "Colour", "Rendered by Blender"),
)
_WRITE = (
    ("pose2sim", "Pose2Sim", "OpenPose JSON and a TOML calibration"),
    ("coco", "COCO", "COCO keypoints"),
    ("c3d", "C3D", "Markers"),
    ("trc", "TRC", "Markers for OpenSim"),
    ("exr", "EXR", "Depth before any sensor and normals, as floats"),
    ("video", "Videos", "One MP4 a camera, of colour pictures"),
)
FAULTS = (
    ("detector", "Detector", "As measured on a real recording of four webcams"),
    ("good_detector", "Good Detector", "Half of that, well calibrated"),
    ("jitter", "Jitter", "5 mm of noise alone"),
    ("optical_markers", "Optical Markers", "Gaps, swaps and noise of optical markers"),
    ("depth_markers", "Depth Markers", "Markers of depth sensors"),
    ("none", "None", "No faults"),
)
_METHODS = (
    ("triangulation", "Triangulation", "No body: what the keypoints themselves reach"),
    *((method.value, method.label, method.description) for method in METHODS),
)
_ENGINES = (
    ("workbench", "Workbench", "Fast"),
    ("eevee", "EEVEE", "Needs a graphics processor"),
    ("cycles", "Cycles", "Lights the room; slow without a graphics processor"),
)


def _forget_plan(self: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    self.planned = ""


class MocapBenchmarkRow(bpy.types.PropertyGroup):
    """What one camera array reached in one benchmark."""

    array: bpy.props.StringProperty(name="Camera Array", description="Name of the camera array")
    faults: bpy.props.EnumProperty(name="Faults", description="What the detector made of the truth", items=FAULTS)
    reached: bpy.props.StringProperty(name="Reached", description="Mean joint error of each method")
    median_mm: bpy.props.FloatProperty(
        name="Median", description="Median error of triangulated keypoints over the floor, mm; -1 where nobody is"
    )
    page: bpy.props.StringProperty(name="Page", description="The benchmark's page", subtype="FILE_PATH")
    places: bpy.props.StringProperty(name="Places", description="File of errors by place", subtype="FILE_PATH")


class MocapStudio(bpy.types.PropertyGroup):
    """What is filmed and evaluated."""

    motion: bpy.props.EnumProperty(name="Motion", description="What is done", items=_MOTIONS, update=_forget_plan)
    motion_path: bpy.props.StringProperty(
        name="Path", description="Motion file or a folder of them", subtype="FILE_PATH", options=RELATIVE,
        update=_forget_plan,
    )  # fmt: skip
    frames: bpy.props.IntProperty(
        name="Frames", description="Frames of a shot at most", default=60, min=1, max=100_000, update=_forget_plan
    )
    fps: bpy.props.FloatProperty(
        name="Rate", description="Pictures per second", default=30, min=1, max=1000, update=_forget_plan
    )
    people: bpy.props.IntProperty(
        name="People", description="Number of people, each filmed alone", default=1, min=1, max=1000,
        update=_forget_plan,
    )  # fmt: skip
    strange: bpy.props.BoolProperty(
        name="Unusual Proportions", description="Bones and flesh beyond the shapes of our body", update=_forget_plan
    )
    seed: bpy.props.IntProperty(
        name="Seed", description="Another number draws other people, clothes and faults", min=0, update=_forget_plan
    )
    array: bpy.props.EnumProperty(
        name="Camera Array", description="Cameras that film", items=_ARRAYS, update=_forget_plan
    )
    count: bpy.props.IntProperty(
        name="Cameras", description="Of the ring", default=4, min=1, max=64, update=_forget_plan
    )
    radius_m: bpy.props.FloatProperty(
        name="Radius", description="Of the ring", default=3.0, min=0.2, max=50, unit="LENGTH", update=_forget_plan
    )
    height_m: bpy.props.FloatProperty(
        name="Height", description="Of the ring's cameras", default=1.4, min=0, max=20, unit="LENGTH",
        update=_forget_plan,
    )  # fmt: skip
    look: bpy.props.EnumProperty(name="Look", description="Clothes and room", items=_LOOKS, update=_forget_plan)
    film: bpy.props.EnumProperty(
        name="Film", description="Which pictures are made", items=_FILM, options={"ENUM_FLAG"},
        default={"infrared", "depth", "masks"}, update=_forget_plan,
    )  # fmt: skip
    write: bpy.props.EnumProperty(
        name="Write", description="Formats of other programs", items=_WRITE, options={"ENUM_FLAG"}, default=set(),
        update=_forget_plan,
    )  # fmt: skip
    faults: bpy.props.EnumProperty(
        name="Faults", description="What detectors and trackers make of the truth", items=FAULTS, update=_forget_plan
    )
    engine: bpy.props.EnumProperty(
        name="Engine", description="What renders colour", items=_ENGINES, update=_forget_plan
    )
    scale: bpy.props.FloatProperty(
        name="Pictures", description="Share of the cameras' picture sizes", default=1.0, min=0.05, max=4.0,
        update=_forget_plan,
    )  # fmt: skip
    out: bpy.props.StringProperty(
        name="Folder", description="Where the data set goes; empty for a new folder beside the takes",
        subtype="DIR_PATH", options=RELATIVE, update=_forget_plan,
    )  # fmt: skip
    planned: bpy.props.StringProperty(name="Plan", description="What would be made and what room it needs")
    planned_file: bpy.props.StringProperty(name="Description", description="File of what was checked")
    planned_out: bpy.props.StringProperty(name="Data Set", description="Folder of what was checked")
    methods: bpy.props.EnumProperty(
        name="Methods", description="Methods to compare", items=_METHODS, options={"ENUM_FLAG"},
        default={"triangulation", "global"},
    )  # fmt: skip
    against: bpy.props.EnumProperty(
        name="Compare With", description="Other camera layouts to compare with", items=PRESET_ARRAYS,
        options={"ENUM_FLAG"}, default=set(),
    )  # fmt: skip
    fewer: bpy.props.BoolProperty(name="One Camera Fewer", description="Also evaluate the cameras without the last")
    rows: bpy.props.CollectionProperty(
        type=MocapBenchmarkRow, name="Rows", description="Expected accuracy per camera layout"
    )
    shown_mm: bpy.props.FloatVectorProperty(
        name="Colours", description="Errors of the first and the last colour of the map that is shown, mm", size=2
    )
