"""The sensor array: find its cameras, record the wand and the Γ, calibrate, and record takes with a live view."""

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
from ..setting_properties import choice
from .base import IDLE, OBJECT_MODE, Call, MocapOperator, Need, SolverOperator, options
from .live import ALONE, live, require_there

if TYPE_CHECKING:
    from ..._exchange.verb_results import OaksResult, SensorsResult


_PARTS = tuple((name, *texts[:2]) for name, texts in PARTS.items())
_SENSORS = Need("Choose a recording of sensors, or find cameras", lambda context: context.scene.mocap.sensors.sensors())


class MOCAP_OT_find_sensors(SolverOperator, bpy.types.Operator):
    """List the OAK cameras on USB and the network."""

    bl_label = "Find Cameras"
    verb = "oaks"
    is_of_capture = False

    def call(self, context: bpy.types.Context) -> Call:
        return Call([], usable(files_folder(context.scene)))

    def received(self, context: bpy.types.Context, result: OaksResult) -> set[str]:
        """Add the cameras that are not listed."""
        sensors, found = context.scene.mocap.sensors, list(result["oaks"])
        known = {oak.partition("=")[0] for oak in sensors.oaks.split()}
        sensors.oaks = " ".join([*sensors.oaks.split(), *(oak for oak in found if oak not in known)])
        message = f"{counted(len(found), 'camera')}: {', '.join(found)}" if found else "No OAK camera was found"
        return self.finish(message, warn=not found)


class MOCAP_OT_start_sensors(MocapOperator, bpy.types.Operator):
    """Start the sensors, and show and record what they see."""

    bl_label = "Start Sensors"
    needs = (ALONE, OBJECT_MODE, _SENSORS)

    part: choice("For", "Kind of recording", _PARTS, "TAKE", options={"SKIP_SAVE"})

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return PARTS[properties.part][1]

    def work(self, context: bpy.types.Context) -> None:
        from ...solving.live import start_sensors

        scene, sensors, part = context.scene, context.scene.mocap.sensors, self.part
        require_there(sensors.subject, sensors.source if sensors.kind == "FOLDER" else "")
        folder = usable(files_folder(scene))
        words = {"WAND": ["--wand"], "GAMMA": ["--wand", "--seconds", f"{GAMMA_S:g}"], "TAKE": ["--poses"]}[part]
        if part == "TAKE":
            words += sending_options(sensors) + options(subject=sensors.subject and absolute(sensors.subject))
        if sensors.record:
            words += options(record=next_path(folder, PARTS[part][2]))
        run = start_sensors([*sensors.sensors(), *words], chosen_python(context), folder)
        live.begin(run, scene, body=part == "TAKE", on_recorded=partial(_keep_recording, scene.name, part))


class MOCAP_OT_calibrate_sensors(SolverOperator, bpy.types.Operator):
    """Calibrate the sensors with the wand, and set origin and up axis with the Γ on the floor."""

    bl_label = "Calibrate"
    verb = "calibrate-wand"
    is_of_capture = False
    needs = (
        Need("Wave the wand first, or choose a recording of it", lambda context: context.scene.mocap.sensors.wand),
        IDLE,
    )

    def call(self, context: bpy.types.Context) -> Call:
        sensors = context.scene.mocap.sensors
        require_there(sensors.wand, sensors.gamma)
        folder = usable(files_folder(context.scene))
        out = options(out=next_path(folder, "sensor_array", ".toml"))
        return Call([*sensors.calibrating(), *out], folder)

    def received(self, context: bpy.types.Context, result: SensorsResult) -> set[str]:
        sensors = context.scene.mocap.sensors
        sensors.calibration = stored(Path(result["calibration"]))
        remarks = [*result.get("findings", ()), *result.get("notes", ())]
        sensors.findings = "\n".join(str(sentence) for sentence in remarks)
        look = f"; {counted(len(remarks), 'remark')}, see the panel" if remarks else ""
        return self.finish(f"The sensors are calibrated{look}", warn=result.get("findings"))


def _keep_recording(scene: str, part: str, recorded: str) -> None:
    """Store the folder of a finished recording in the settings of the sensor array."""
    found = bpy.data.scenes.get(scene)
    if found is not None and recorded:
        setattr(found.mocap.sensors, PARTS[part][2], recorded)
