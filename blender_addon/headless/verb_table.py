"""The table of the verbs of ``python -m blender_addon``."""

from __future__ import annotations

from dataclasses import replace

from .._exchange.diagnostics import list_refusals
from .._exchange.errors import describe_exit_codes
from .._exchange.marker_formats import MARKER_FORMATS
from .._exchange.setting import POSITIVE, REQUIRED, Setting
from .._exchange.verb import Program, Verb, by_name, flag, option, output, place, values
from .._exchange.verbs import SHARED
from ..conventions.naming import LOOKS
from ..conventions.skeleton import NUM_BETAS
from ..export.formats import FORMATS
from .certificates import DAYS

[BENCHMARK_SETTINGS], [JSON], [OVERWRITE], [PARENT_PIPE], [PLACES], [SPEC], [TLS] = map(
    SHARED.__getitem__, ("BENCHMARK_SETTINGS", "JSON", "OVERWRITE", "PARENT_PIPE", "PLACES", "SPEC", "TLS")
)
MODULE = "python -m blender_addon"
_SOLVE, _SHOW, _CHARACTERS, _MANY = "Solving", "Baking, rendering, exporting", "Characters and clips", "Many takes"
_FORMATS = values(*FORMATS)
_COMMON = (JSON, PARENT_PIPE, flag("verbose", "Show what Blender prints, on standard error"))
_BODY = option("path", "body", "BODY.npz", "Body file; the motion's, or the add-on's own, if left out")
_LOOK = option("choice", "look", "", "A person, or a mannequin: one colour and no face", "", choices=values(*LOOKS))
_OUT = output("DIR", "Folder of the results", kind="folder", is_output=False)
_PYTHON = option("path", "python", "PATH", "The Python to solve with, such as one that has torch")
_MOTION = (
    place("path", "motion", "MOTION.npz", "Motion file"),
    option("path", "capture", "CAPTURE.npz", "Capture file: adds cameras, footage and detections"),
    option("folder", "footage_from", "DIR", "Folders, besides the capture's, in which its footage may be; / for "
           "anywhere", (), many=True),
    _BODY, _LOOK, _OUT, OVERWRITE,
)  # fmt: skip
_FPS = option("number", "fps", "N", "Frame rate of the scene; the motion's if left out", low=POSITIVE)
_MOTION_OUT = output("MOTION.npz", "Motion file to write", is_output=False)


def _seconds(name: str, description: str, default: float | None = None) -> Setting:
    return option("number", name, "S", description, default, low=POSITIVE)


def _workers(what: str) -> tuple[Setting, ...]:
    """Return the options of work that is spread over processes."""
    return (
        option("text", "scheduler", "ADDRESS", "Spread over the workers of a Dask scheduler", "", excludes="workers"),
        option("whole", "workers", "N", f"Number of {what} at a time on this machine", 0, low=1, high=1024,
               excludes="workers"),
        TLS,
        _seconds("patience", "Seconds to wait for scheduler and workers", 60.0),
    )  # fmt: skip


VERBS = by_name((
    Verb(
        "solve", _SOLVE, "solve", "solve a capture; takes the solver's options, such as --job JOB.json",
        "solve capture --out motion.npz", "children:pass_on", (_PYTHON,), passes_on=True,
    ),
    Verb(
        "calibrate", _SOLVE, "markers",
        "learn a person's shape and marker positions; takes the solver's options",
        "calibrate range_of_motion.c3d --out subject.npz", "children:pass_on", (_PYTHON,), passes_on=True,
    ),
    Verb(
        "export-markers", _SOLVE, "markers", "write a motion's markers; takes the solver's options",
        "export-markers motion.npz --out cleaned.c3d", "children:pass_on", (_PYTHON,), passes_on=True,
    ),
    Verb(
        "bake", _SHOW, "blender", "write an animated body, its preview video and a contact sheet",
        "bake motion.npz --capture capture.npz --out baked", "bake:run_bake",
        (
            *_MOTION,
            flag("no_video", "Leave out the preview video"),
            flag("no_pictures", "Write the Blender file alone"),
            option("number", "keys_per_second", "N", "About how many keys to keep in a second, such as 2",
                   low=POSITIVE),
            option("number", "keys_within", "MM", "Keep as few keys as possible, with every joint within this many mm",
                   low=POSITIVE),
            _FPS,
            flag("asset", "Mark the action as an asset"),
        ),
    ),
    Verb(
        "render", _SHOW, "blender", "write a preview video and a contact sheet", "render motion.npz --out preview",
        "bake:run_render", _MOTION,
    ),
    Verb(
        "export", _SHOW, "blender", "write a take in the formats of other programs",
        "export motion.npz --format fbx gltf --out files", "export:run_export",
        (
            place("path", "source", "MOTION.npz|FILE.blend", "Motion file or Blender file"),
            option("choice", "formats", "", "Formats to write", REQUIRED, choices=_FORMATS, many=True,
                   option="--format"),
            replace(_FPS, description="Frames per second of the files; the solve's if left out"),
            option("text", "armature", "NAME", "Armature to export, of a Blender file", ""),
            _BODY, _LOOK, _OUT, OVERWRITE,
        ),
    ),
    Verb(
        "body", _SHOW, "blender", "write the posable body as an asset", "body --out assets/body.blend --fingers",
        "body:run_body",
        (
            output("FILE.blend", "Blender file, never replaced; its folder becomes an asset library",
                   endings=(".blend",), is_output=False),
            option("numbers", "betas", "B0,B1,…", "Values of the shape sliders (write --betas=-1,2)", (), low=1,
                   high=NUM_BETAS),
            flag("fingers", "Add finger bones, and controls that curl and spread them"),
            _BODY, _LOOK,
        ),
    ),
    Verb(
        "retarget", _CHARACTERS, "blender", "retarget a solved motion to another character's rig",
        "retarget motion.npz --target hero.blend --out hero_walks.blend", "retarget:run_retarget",
        (
            place("path", "source", "SOURCE", "Motion, a moving armature (.blend, .fbx, .glb, .bvh), or a folder"),
            option("path", "target", "RIG", "The rig (.blend, .fbx, .glb, .vrm), which is not changed; each gets a "
                   "folder if there are several", REQUIRED, repeated=True),
            option("text", "object", "NAME", "Armature of the target", ""),
            output("OUT.blend", "File to write; MOTION_retargeted.blend if left out", None, endings=(".blend",),
                   is_output=False),
            option("text", "armature", "NAME", "Armature of the source that is the actor", ""),
            option("text", "action", "NAME", "Action of the source; the one that it shows if left out", ""),
            option("text", "preset", "NAME", "Preset of the rig's kind; detected if left out", "", excludes="map"),
            option("path", "map", "MAP.json", "Map of the rig's bones, instead of a preset", excludes="map"),
            option("path", "save_map", "MAP.json", "Write the map that was used, with its map pose"),
            option("choice", "limbs", "", "FK or IK in the rig's switches; both are keyed", "fk",
                   choices=values("fk", "ik")),
            option("number", "scale", "S", "Scale of the travel relative to the actor's; the ratio of the legs if left "
                   "out", 0.0, low=POSITIVE),
            flag("in_place", "Remove the travel over the ground", excludes="travel"),
            flag("root_motion", "Put the travel over the ground on the root bone", excludes="travel"),
            option("whole", "frame_start", "N", "Scene frame of the first frame", 1),
            option("choice", "export", "FORMAT", "For a folder: also write each clip in these formats", (),
                   choices=_FORMATS, many=True),
            _BODY, OVERWRITE,
        ),
    ),
    Verb(
        "motion", _CHARACTERS, "motion", "convert a clip of another program to our body",
        "motion clip.fbx --out motion.npz", "motion:run_motion",
        (
            place("path", "clip", "CLIP", "FBX, glTF, VRM, Blender file, BVH, MVNX, C3D segments or AMASS"),
            _MOTION_OUT,
            option("text", "armature", "NAME", "Armature of the clip, if several move", ""),
            option("text", "action", "NAME", "Action of the armature; the one that it shows if left out", ""),
            _PYTHON,
        ),
        passes_on=True,
    ),
    Verb(
        "add-hands", _CHARACTERS, "hands", "add the fingers of gloves, or of another program, to a motion",
        "add-hands motion.npz gloves.fbx --out hands.npz", "motion:run_add_hands",
        (
            place("path", "hands_of", "MOTION.npz", "Motion to which the hands are added"),
            place("path", "gloves", "GLOVES", "FBX, glTF, Blender file, BVH, or CSV of MANUS or Rokoko", many=True),
            output("OUT.npz", "Motion file to write", is_output=False),
            option("text", "armature", "NAME", "Armature of the recording, if several move", ""),
            _PYTHON,
        ),
        passes_on=True,
    ),
    Verb(
        "batch", _MANY, "solve", "solve, bake and export every capture of a folder; resumes",
        "batch captures --out takes --job job.json --bake --export fbx", "batch.run_batch:run_batch_verb",
        (
            place("folder", "captures", "FOLDER", "Folder of the captures: files .npz, recordings of markers, folders",
                  None),
            _OUT,
            option("folder", "watch", "FOLDER", "Folder to watch, instead of FOLDER: solve what arrives in it"),
            _seconds("settled", "With --watch: seconds a capture must be unchanged", 5.0),
            _seconds("idle", "With --watch: stop when nothing arrives for this many seconds"),
            *_workers("takes"),
            flag("stretches", "With --scheduler: also spread the stretches of each long take"),
            option("path", "job", "JOB.json", "Settings of the solves: a job file without capture and out"),
            flag("strict", "Refuse takes whose solves have warnings"),
            option("choice", "accept", "CODE", "Accept results with this fault, which are refused otherwise", (),
                   choices=values(*list_refusals()), repeated=True),
            flag("bake", "Write a Blender file of each take"),
            flag("render", "Write a video and a contact sheet of each take"),
            _seconds("take_seconds", "Stop the solver of a take after this many seconds"),
            option("number", "take_memory", "MB", "Stop the solver of a take that uses more memory (Linux)",
                   low=POSITIVE),
            option("choice", "export", "FORMAT", "Formats to export to", (), choices=_FORMATS, many=True),
            option("choice", "export_markers", "FORMAT", "Write the cleaned markers of takes of markers", (),
                   choices=values(*MARKER_FORMATS), many=True),
            _BODY, _PYTHON,
        ),
    ),
    Verb(
        "studio", _MANY, "dataset", "render synthetic captures with ground truth", "studio spec.json --out set",
        "studio:run_studio",
        (
            SPEC,
            output("DIR", "Folder of the data set; an interrupted run resumes", kind="folder", is_output=False),
            flag("plan", "Check the description; report what would be made and its size"),
            option("text", "benchmark", "METHOD", "Also solve by these methods and compare", (), many=True),
            PLACES, BENCHMARK_SETTINGS,
            option("text", "colour_of", "SHOT", "Only render the colour pictures of a shot that was filmed", ""),
            *_workers("shots"), _PYTHON,
        ),
    ),
    Verb(
        "certificates", _MANY, "solve", "make the TLS certificates of a cluster of several machines",
        "certificates --out tls", "certificates:run_certificates",
        (_OUT, option("whole", "days", "N", "Days for which they are valid", DAYS, low=1, high=1024), OVERWRITE),
    ),
))  # fmt: skip
"""By name, in the order of the help."""


_EPILOG = describe_exit_codes(
    "a file is missing, damaged or unusable, or an output exists or cannot be written",
    "the solver failed, or Blender is missing, cannot render or export here",
    "A batch has the code of its worst take.\n",
)


def program(name: str = MODULE) -> Program:
    """Return the command line."""
    description = "Solve captures, and bake, export and render solved motions, without a window."
    return Program(name, description, VERBS, _COMMON, _EPILOG)
