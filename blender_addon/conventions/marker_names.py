"""Names of the 53 markers that a network distinguishes; a point is one of them, or none."""

from __future__ import annotations

MARKERS: tuple[str, ...] = (
    "LFHD", "RFHD", "LBHD", "RBHD", "C7", "T10", "CLAV", "STRN", "RBAC", "LSHO", "RSHO", "LUPA", "RUPA", "LELB",
    "RELB", "LFRM", "RFRM", "LWRA", "RWRA", "LWRB", "RWRB", "LFIN", "RFIN", "LFWT", "RFWT", "LBWT", "RBWT", "LTHI",
    "RTHI", "LKNE", "RKNE", "LSHN", "RSHN", "LANK", "RANK", "LHEE", "RHEE", "LMT5", "RMT5", "LTOE", "RTOE", "LBAC",
    "T4", "SACR", "ARIEL", "LELM", "RELM", "LKNM", "RKNM", "LANM", "RANM", "LMT1", "RMT1",
)  # fmt: skip
