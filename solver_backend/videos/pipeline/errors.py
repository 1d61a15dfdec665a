"""Named errors of the road from videos."""

from __future__ import annotations

from solver_backend.exchange.errors import MocapError


class NoVideos(MocapError):
    """A folder holds no take: videos of two cameras or more."""

    code = "no_videos"
