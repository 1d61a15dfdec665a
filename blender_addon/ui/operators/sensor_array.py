"""The sensor array: which are there, the wand and the Γ, points and body while they are seen, and the take."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ...conventions.file_paths import absolute, stored
from ...conventions.naming import counted, next_path
from ..acquisition_properties import GAMMA_S, PARTS, sending_options
from ..preferences import chosen_python
from ..project_files import files_folder, usable
from .base import MocapOperator, SolverOperator
from .live import live, may_begin, require_there

if TYPE_CHECKING:
    from ..._exchange.verb_results import OaksResult, SensorsResult


class MOCAP_OT_rig_find(SolverOperator, bpy.types.Operator):
    """Lists the cameras that are there."""

    bl_idname = "mocap.rig_find"
    bl_label = "Find Cameras"
    bl_description = "List the OAK cameras that are plugged in or on the network"

    is_of_capture = False

    def work(self, context: bpy.types.Context) -> set[str]:
        """Ask for them."""
        return self.launch(context, "oaks", [], usable(files_folder(context.scene)))

    def received(self, context: bpy.types.Context, result: OaksResult) -> set[str]:
        """Take those that are not named yet."""
        rig, found = context.scene.mocap.rig, list(result["oaks"])
        known = {oak.partition("=")[0] for oak in rig.oaks.split()}
        rig.oaks = " ".join([*rig.oaks.split(), *(oak for oak in found if oak not in known)])
        message = f"{counted(len(found), 'camera')}: {', '.join(found)}" if found else "No OAK camera was found"
        self.report({"INFO"} if found else {"WARNING"}, message)
        return {"FINISHED"}


class MOCAP_OT_rig_start(MocapOperator, bpy.types.Operator):
    """Starts the sensors."""

    bl_idname = "mocap.rig_start"
    bl_label = "Start Sensors"
    bl_description = "Start the sensors"

    part: bpy.props.EnumProperty(
        name="For", items=[(name, *texts[:2]) for name, texts in PARTS.items()], default="TAKE", options={"SKIP_SAVE"}
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """Return what starting them for this is good for."""
        return PARTS[properties.part][1]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One run at a time, in object mode, and sensors."""
        return may_begin(
            cls, context, context.scene.mocap.rig.sensors(), "Choose a recording of sensors, or find cameras"
        )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start the sensors' process and make what shows it."""
        from ...solving.live import start_sensors

        scene, rig, part = context.scene, context.scene.mocap.rig, self.part
        require_there(rig.subject, rig.source if rig.kind == "FOLDER" else "")
        folder = usable(files_folder(scene))
        options = {"WAND": ["--wand"], "GAMMA": ["--wand", "--seconds", f"{GAMMA_S:g}"], "TAKE": ["--poses"]}[part]
        if part == "TAKE":
            options += sending_options(rig)
        if part == "TAKE" and rig.subject:
            options += ["--subject", str(absolute(rig.subject))]
        if rig.record:
            options += ["--record", str(next_path(folder, PARTS[part][2]))]
        run = start_sensors([*rig.sensors(), *options], chosen_python(context), folder)
        live.begin(run, scene, body=part == "TAKE", on_recorded=partial(_keep_recording, scene.name, part))
        return {"FINISHED"}


class MOCAP_OT_rig_calibrate(SolverOperator, bpy.types.Operator):
    """Finds where the sensors stand."""

    bl_idname = "mocap.rig_calibrate"
    bl_label = "Calibrate"
    bl_description = "Find where the sensors stand by the wand that was waved, and where up is by the Γ on the floor"

    is_of_capture = False

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a wand."""
        if not context.scene.mocap.rig.wand:
            cls.poll_message_set("Wave the wand first, or choose a recording of it")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start; an earlier calibration stays beside the new one."""
        rig = context.scene.mocap.rig
        require_there(rig.wand, rig.gamma)
        folder = usable(files_folder(context.scene))
        out = next_path(folder, "sensor_array", ".toml")
        return self.launch(context, "calibrate-wand", [*rig.calibrating(), "--out", str(out)], folder)

    def received(self, context: bpy.types.Context, result: SensorsResult) -> set[str]:
        """Use the calibration, and keep what was reported about it."""
        rig = context.scene.mocap.rig
        rig.calibration = stored(Path(result["calibration"]))
        remarks = [*result.get("findings", ()), *result.get("notes", ())]
        rig.said = "\n".join(str(sentence) for sentence in remarks)
        look = f"; {counted(len(remarks), 'remark')}, see the panel" if remarks else ""
        self.report({"WARNING"} if result.get("findings") else {"INFO"}, f"The sensors are calibrated{look}")
        return {"FINISHED"}


def _keep_recording(scene: str, part: str, recorded: str) -> None:
    """Keep where a run recorded as one of the sensor array's folders, once it has."""
    found = bpy.data.scenes.get(scene)
    if found is not None and recorded:
        setattr(found.mocap.rig, PARTS[part][2], recorded)
