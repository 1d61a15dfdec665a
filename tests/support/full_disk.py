"""A disk that fills up: no file of this process or of one it starts grows beyond a size while a block runs."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def full_disk(largest_bytes: int) -> Iterator[None]:
    """Let writing fail beyond a file size; the system says "File too large" where a full disk says "No space left".

    Python would keep cut byte code of modules that are imported meanwhile, so it keeps none.
    """
    resource = pytest.importorskip("resource", reason="limits of file size are not known here")
    limits, usage = resource.getrlimit(resource.RLIMIT_FSIZE), shutil.disk_usage
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest_bytes, limits[1]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "dont_write_bytecode", True)
        patch.setattr(shutil, "disk_usage", lambda path: usage(path)._replace(free=largest_bytes))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
