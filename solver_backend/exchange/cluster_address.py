"""Connect to Dask schedulers of this machine, and to others only through TLS.

Whoever reaches a scheduler runs programs on its workers, and a scheduler can send programs to whoever connects.
"""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path

from .errors import FileMissing, SchedulerUnsafe
from .json_file import read_json_file

CERTIFICATES = {"CA_FILE": "ca.pem", "CLIENT__CERT": "cert.pem", "CLIENT__KEY": "key.pem"}
"""Files in the folder of ``--tls``, by the ending of the variable of the environment that passes each to Dask."""
_PREFIX = "DASK_DISTRIBUTED__COMM__"


def require_safe(address: str) -> None:
    """Make sure that a scheduler is on this machine or speaks TLS.

    Args:
        address: of the scheduler, or the path of its file, which holds the address.

    Raises:
        SchedulerUnsafe: it is on another host and its address does not begin with ``tls://``.
    """
    found = address
    if address.endswith(".json"):
        values = read_json_file(address)
        found = str(values.get("address", "")) if isinstance(values, dict) else ""
    protocol, _, rest = found.rpartition("://")
    if protocol in ("tls", "inproc") or _is_loopback(rest.rpartition(":")[0] if ":" in rest else rest):
        return
    hint = "Start scheduler and workers with TLS, and give tls://HOST:PORT and --tls FOLDER (see the docs)."
    what = f"The scheduler {found or address} is on another host and not encrypted."
    raise SchedulerUnsafe(what, where=address, hint=hint)


def require_certificates(address: str, known: object) -> None:
    """Make sure that there are certificates for a scheduler that speaks TLS.

    Args:
        known: Dask's setting ``distributed.comm.tls.ca-file``, which ``use_certificates`` or the user's own makes.
    """
    if address.startswith("tls://") and not known:
        what = f"The scheduler {address} speaks TLS, and no certificates are given."
        raise SchedulerUnsafe(what, where=address, hint="Give the folder of its certificates: --tls FOLDER.")


def _is_loopback(host: str) -> bool:
    try:
        return host in ("localhost", "") or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def use_certificates(folder: Path) -> None:
    """Give Dask, in this process and in those that it starts, the certificates in a folder.

    To be called before Dask is imported.
    """
    for name, file in CERTIFICATES.items():
        path = folder.absolute() / file
        if not path.is_file():
            raise FileMissing(f"The folder of certificates lacks {file}.", where=str(folder), hint="See the docs.")
        os.environ[f"{_PREFIX}TLS__{name}"] = str(path)
    os.environ[f"{_PREFIX}REQUIRE_ENCRYPTION"] = "true"
