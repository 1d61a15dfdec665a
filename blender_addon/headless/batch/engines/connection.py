"""The connection to a Dask scheduler, which is there or is named as missing."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from ...._exchange.cluster_address import require_certificates, require_safe
from ....errors import EngineMissing, SchedulerMissing


def require_dask() -> None:
    """Make sure that Dask can be used.

    Raises:
        EngineMissing: it is not installed.
    """
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise EngineMissing(
            "Dask is not installed in this Python.", where=str(error),
            hint="Install it with: pip install distributed; or leave out --scheduler and give --workers N.",
        ) from error  # fmt: skip


def connected(address: str, patience_s: float, tend: Callable[[], None]) -> Any:
    """Return a client of a scheduler.

    Args:
        address: of the scheduler, or the path of its file.
        patience_s: how long to try.
        tend: called before each try.

    Raises:
        SchedulerUnsafe: it is on another host, without TLS, or certificates for TLS are not given.
        SchedulerMissing: none answers for so long.
    """
    require_safe(address)
    import dask.config
    from distributed import Client

    require_certificates(address, dask.config.get("distributed.comm.tls.ca-file", None))
    for name in ("distributed", "distributed.client", "distributed.comm", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    end = time.monotonic() + patience_s
    where: dict[str, Any] = {"scheduler_file" if address.endswith(".json") else "address": address}
    while True:
        tend()
        try:
            return Client(**where, timeout=min(5.0, patience_s), set_as_default=False)
        except Exception as error:  # of the network, of the protocol, of another version's messages
            if time.monotonic() > end:
                raise SchedulerMissing(
                    f"No scheduler answers: {type(error).__name__}: {error}.", where=address,
                    hint="Start one with 'dask scheduler' and give its address, such as tcp://10.0.0.5:8786; it must "
                    "have this program's version of Dask. Finished takes are kept.",
                ) from error  # fmt: skip
            time.sleep(0.5)
