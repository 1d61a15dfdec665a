"""What can be wrong with a description of shots, found before anything is rendered."""

from __future__ import annotations

from solver_backend.exchange.errors import JobInvalid, MocapError


class StudioInvalid(JobInvalid):
    """A description of shots has an unknown key or preset, a wrong type or an impossible value."""

    code = "studio_invalid"


class NobodySeen(MocapError):
    """No camera of a shot sees the person in any frame."""

    code = "nobody_seen"


class CameraInsideBody(MocapError):
    """A camera of a shot stands inside the person, or touches it."""

    code = "camera_inside_body"


class DiskTooSmall(MocapError):
    """The data set needs more room than the disk has."""

    code = "disk_too_small"


class OtherDataSet(MocapError):
    """The output folder holds another data set, or something else."""

    code = "other_data_set"
