"""A disk that fills up: no file of this process or of one it starts grows beyond a size while a block runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def full_disk(largest_bytes: int) -> Iterator[None]:
    """Let writing fail beyond a file size; the system says "File too large" where a full disk says "No space left"."""
    resource = pytest.importorskip("resource", reason="limits of file size are not known here")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest_bytes, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
