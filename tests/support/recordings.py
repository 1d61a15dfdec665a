"""Where the recordings are that are kept beside the repository."""

from __future__ import annotations

import os
from pathlib import Path

BALANCING_TRIAL = Path("multiview", "pose2sim", "S00_P00_SingleParticipant", "S00_P00_T01_BalancingTrial")
"""Four cameras at 60 Hz, OpenPose BODY_25B (Pagnon et al. 2021); a folder under ``recordings_folder``."""
ABSENT = "Set MOCAP_SHARED_DATA to the folder of recordings."


def recordings_folder() -> Path:
    """Return the folder that ``MOCAP_SHARED_DATA`` names, else ``shared/data`` beside the repository; it may lack."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("MOCAP_SHARED_DATA", beside))
