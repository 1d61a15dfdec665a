"""What the program's own ``.npz`` files are, by the format that they state, and what reads them."""

from __future__ import annotations

from .errors import FileDamaged

_MOTIONS = "live, denoise and add-hands, and python -m blender_addon bake, export and retarget read motions."
_KINDS = {
    "manifold_mocap_capture": ("a capture", "solve, info and check-cameras read captures."),
    "manifold_mocap_motion": ("a motion of our body", _MOTIONS),
    "manifold_mocap_subject": ("a calibrated person", "solve, label and live read it as --subject."),
    "manifold_mocap_skeleton": ("a clip of another skeleton", "motion converts it to a motion of our body."),
    "manifold_mocap_detections": ("the detections of one video", "from-videos makes a capture of them."),
    "manifold_mocap_prior": ("the weights of a pose prior", "denoise and complete read those of Pose-NDF as --prior."),
    "manifold_mocap_studio_scene": ("the scene of a studio's shot", "python -m blender_addon studio renders it."),
}
"""What it is, and which verbs read it."""


def other_kind(found: str, expected: str, where: str) -> FileDamaged:
    """Return the error about a file that states another format than the expected one, or none.

    Args:
        found: format that the file states, "" for none.
        expected: format that was to be read.
        where: the file.
    """
    wanted = _KINDS[expected][0]
    if found in _KINDS:
        what, readers = _KINDS[found]
        hint = readers[0].upper() + readers[1:]
        return FileDamaged(f"The file is {what}; {wanted} is expected.", where=where, hint=hint)
    stated = f"its format is '{found}'" if found else "it names no format"
    return FileDamaged(f"The file is not {wanted}: {stated}.", where=where)
