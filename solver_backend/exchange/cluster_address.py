"""Accept Dask schedulers on this machine, and require TLS for all others.

A scheduler runs code from anyone who can connect to it, and may send code to its clients.
"""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path

from .errors import FileMissing, SchedulerUnsafe
from .json_file import read_json_file

CERTIFICATES = {"CA_FILE": "ca.pem", "CLIENT__CERT": "cert.pem", "CLIENT__KEY": "key.pem"}
"""Files in the ``--tls`` folder, by the ending of Dask's environment variable for each."""
_PREFIX = "DASK_DISTRIBUTED__COMM__"


def require_safe(address: str) -> None:
    """Check that a scheduler is on this machine or uses TLS.

    Args:
        address: address of the scheduler, or path of a file that contains it.

    Raises:
        SchedulerUnsafe: the scheduler is on another host, and its address does not begin with ``tls://``.
    """
    found = address
    if address.endswith(".json"):
        values = read_json_file(address)
        found = str(values.get("address", "")) if isinstance(values, dict) else ""
    protocol, _, rest = found.rpartition("://")
    if protocol in ("tls", "inproc") or _is_loopback(rest.rpartition(":")[0] if ":" in rest else rest):
        return
    hint = (
        "Start scheduler and workers with TLS, and use tls://HOST:PORT and --tls FOLDER. See "
        "docs/how-to/batch-and-cluster.md."
    )
    what = f"The connection to the scheduler {found or address} on another host is not encrypted."
    raise SchedulerUnsafe(what, where=address, hint=hint)


def require_certificates(address: str, known: object) -> None:
    """Raise ``SchedulerUnsafe`` if a scheduler uses TLS, but Dask has no certificates (``known`` is empty)."""
    if address.startswith("tls://") and not known:
        what = f"The scheduler {address} uses TLS, but no certificates were specified."
        raise SchedulerUnsafe(what, where=address, hint="Specify the folder with its certificates: --tls FOLDER.")


def _is_loopback(host: str) -> bool:
    try:
        return host in ("localhost", "") or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def use_certificates(folder: Path) -> None:
    """Pass the certificates in a folder to Dask. Call this before importing Dask."""
    for name, file in CERTIFICATES.items():
        path = folder.absolute() / file
        if not path.is_file():
            raise FileMissing(
                f"The certificate folder does not contain {file}.",
                where=str(folder),
                hint="See docs/how-to/batch-and-cluster.md.",
            )
        os.environ[f"{_PREFIX}TLS__{name}"] = str(path)
    os.environ[f"{_PREFIX}REQUIRE_ENCRYPTION"] = "true"
