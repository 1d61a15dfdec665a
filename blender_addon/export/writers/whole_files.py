"""Guards around Blender's USD and Alembic exporters, which on a full disk report success or take Blender down.

(Blender 4.5: USD leaves a cut file and returns FINISHED, Alembic ends the process in ``std::ios_base::failure``.)
"""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

_RESERVE = 2**20
"""Bytes that stay free beside what is estimated; chosen by hand."""
_OGAWA, _FROZEN = b"Ogawa", 0xFF
_CRATE = b"PXR-USDC"


def require_space(path: Path, estimate: int) -> None:
    """Check that a file of about so many bytes, and a little more, fits on its disk.

    Raises:
        OSError: it does not.
    """
    free = shutil.disk_usage(path.parent).free
    if free < estimate + _RESERVE:
        mib = f"about {estimate / 2**20:.0f} MiB are needed, {free / 2**20:.0f} MiB are free"
        raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}, {mib}")


def require_whole(path: Path) -> None:
    """Check that an Alembic (Ogawa) or USD (crate) file was written to its end.

    Ogawa's sixth byte is 255 once the archive is closed; a crate's header ends with the offset of a table of contents
    that is written last.

    Raises:
        OSError: it was not.
    """
    with path.open("rb") as stream:
        head = stream.read(24)
    is_whole = {
        _OGAWA: head[5:6] == bytes([_FROZEN]),
        _CRATE[:5]: head[:8] == _CRATE and 0 < int.from_bytes(head[16:24], "little") < path.stat().st_size,
    }
    if not is_whole.get(head[:5], False):
        raise OSError(errno.ENOSPC, "the exporter stopped in the middle of the file; the disk may be full")
