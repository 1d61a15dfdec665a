"""Named errors of videos."""

from __future__ import annotations

from solver_backend.exchange.errors import MocapError


class VideoUnreadable(MocapError):
    """A video is missing, empty, broken or no video at all."""

    code = "video_unreadable"


class VideoWithoutSound(MocapError):
    """A video has no sound, or only silence, where sound is needed."""

    code = "video_without_sound"


class SameVideoTwice(MocapError):
    """Two cameras have the very same video."""

    code = "same_video_twice"
