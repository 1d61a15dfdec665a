"""Certificates by which a cluster's scheduler, workers and clients know one another, made by OpenSSL."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from .._exchange.cluster_address import CERTIFICATES
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..errors import EngineMissing
from .result import CommandResult

DAYS = 365
"""That a certificate is valid where nothing else is asked for; chosen by hand."""
_KEY, _CERTIFICATE, _AUTHORITY = CERTIFICATES["CLIENT__KEY"], CERTIFICATES["CLIENT__CERT"], CERTIFICATES["CA_FILE"]
_OWNER_ALONE = 0o600
"""Permissions: its owner reads and writes it."""
_REQUEST = (
    "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-sha256", "-nodes", "-subj",
    "/CN=mocap",
)  # fmt: skip


class CertificatesResult(CommandResult):
    """Of ``certificates``."""

    days: int


def run_certificates(out: Path, days: int, overwrite: bool, progress: Progress) -> CertificatesResult:
    """Write a key on the curve P-256 and its certificate, which is its own authority, into a folder.

    Args:
        out: the folder; whoever holds its key may run programs on the workers.
        days: that the certificate is valid.
        overwrite: replace files that are there.
        progress: called before and after.

    Raises:
        EngineMissing: OpenSSL is not there, or makes none.
        OutputExists, OutputNotWritable: the files cannot be written.
    """
    program = shutil.which("openssl")
    if program is None:
        raise EngineMissing("The program openssl, which makes certificates, is not installed.", hint="Install OpenSSL.")
    progress("Certificates", 0, 1)
    with atomic_outputs(out, (_KEY, _CERTIFICATE, _AUTHORITY), overwrite=overwrite) as parts:
        parts[_KEY].touch(_OWNER_ALONE)
        made = subprocess.run(
            [program, *_REQUEST, "-days", str(days), "-keyout", str(parts[_KEY]), "-out", str(parts[_CERTIFICATE])],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if made.returncode != 0:
            raise EngineMissing(f"openssl made no certificate: {made.stderr.strip()[-200:]}", where=program)
        parts[_KEY].chmod(_OWNER_ALONE)
        shutil.copyfile(parts[_CERTIFICATE], parts[_AUTHORITY])
    progress("Certificates", 1, 1)
    outputs = [str(out / name) for name in (_AUTHORITY, _CERTIFICATE, _KEY)]
    return {"event": "result", "outputs": outputs, "days": days, "notes": []}
