"""The verbs of ``python -m blender_addon``: by task, with an example each."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BlenderVerb:
    """A verb of the command line."""

    task: str
    """What it is listed under."""
    shared: str
    """Keys of the shared options, blanks between."""
    help: str
    """What it does."""
    example: str
    """A command line without the program."""


_SOLVE, _SHOW, _CHARACTERS, _MANY = "Solving", "Baking, rendering, exporting", "Characters and clips", "Many takes"
_MOTION = "motion body look out writing common"
VERBS = {
    "solve": BlenderVerb(
        _SOLVE, "python common", "solve a capture; takes the solver's options, such as --job JOB.json",
        "solve capture --out motion.npz",
    ),
    "calibrate": BlenderVerb(
        _SOLVE, "python common", "learn a person's shape and marker positions; takes the solver's options",
        "calibrate range_of_motion.c3d --out subject.npz",
    ),
    "export-markers": BlenderVerb(
        _SOLVE, "python common", "write a motion's markers; takes the solver's options",
        "export-markers motion.npz --out cleaned.c3d",
    ),
    "bake": BlenderVerb(
        _SHOW, _MOTION, "write an animated body, its preview video and a contact sheet",
        "bake motion.npz --capture capture.npz --out baked",
    ),
    "render": BlenderVerb(
        _SHOW, _MOTION, "write a preview video and a contact sheet", "render motion.npz --out preview"
    ),
    "export": BlenderVerb(
        _SHOW, "body look out writing common", "write a take in the formats of other programs",
        "export motion.npz --format fbx gltf --out files",
    ),
    "body": BlenderVerb(
        _SHOW, "body look common", "write the posable body as an asset", "body --out assets/body.blend --fingers"
    ),
    "retarget": BlenderVerb(
        _CHARACTERS, "body writing common", "retarget a solved motion to another character's rig",
        "retarget motion.npz --target hero.blend --out hero_walks.blend",
    ),
    "motion": BlenderVerb(
        _CHARACTERS, "python common", "convert a clip of another program to our body",
        "motion clip.fbx --out motion.npz",
    ),
    "add-hands": BlenderVerb(
        _CHARACTERS, "python common", "add the fingers of gloves, or of another program, to a motion",
        "add-hands motion.npz gloves.fbx --out hands.npz",
    ),
    "batch": BlenderVerb(
        _MANY, "body out python common", "solve, bake and export every capture of a folder; resumes",
        "batch captures --out takes --job job.json --bake --export fbx",
    ),
    "studio": BlenderVerb(
        _MANY, "python common", "render synthetic captures with ground truth", "studio spec.json --out set"
    ),
    "certificates": BlenderVerb(
        _MANY, "out writing common", "make the TLS certificates of a cluster of several machines",
        "certificates --out tls",
    ),
}  # fmt: skip
"""By name, in the order of the help."""
