"""Create a key and a certificate for a cluster with OpenSSL."""

from __future__ import annotations

import shutil
import subprocess
from argparse import Namespace

from .._exchange.cluster_address import CERTIFICATES
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..errors import EngineMissing
from .result import CommandResult

_KEY, _CERTIFICATE, _AUTHORITY = CERTIFICATES["CLIENT__KEY"], CERTIFICATES["CLIENT__CERT"], CERTIFICATES["CA_FILE"]
_OWNER_ALONE = 0o600
"""File permissions that let only the owner read and write."""
_CURVE = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"]
_REQUEST = ["req", "-x509", *_CURVE, "-sha256", "-nodes", "-subj", "/CN=mocap"]
"""OpenSSL arguments that create a key on the curve P-256 and its certificate."""


def run_certificates(args: Namespace, progress: Progress) -> CommandResult:
    """Write a P-256 key and its self-signed certificate to a folder.

    Anyone who has the key can run programs on the workers.
    """
    program = shutil.which("openssl")
    if program is None:
        raise EngineMissing("The program openssl, which makes certificates, is not installed.", hint="Install OpenSSL.")
    progress("Certificates", 0, 1)
    with atomic_outputs(args.out, (_KEY, _CERTIFICATE, _AUTHORITY), overwrite=args.overwrite) as parts:
        key, certificate = parts[_KEY], parts[_CERTIFICATE]
        key.touch(_OWNER_ALONE)
        words = [*_REQUEST, "-days", str(args.days), "-keyout", str(key), "-out", str(certificate)]
        made = subprocess.run([program, *words], capture_output=True, text=True, check=False)
        if made.returncode != 0:
            raise EngineMissing(f"openssl created no certificate: {made.stderr.strip()[-200:]}", where=program)
        key.chmod(_OWNER_ALONE)
        shutil.copyfile(certificate, parts[_AUTHORITY])
    progress("Certificates", 1, 1)
    outputs = [str(args.out / name) for name in (_AUTHORITY, _CERTIFICATE, _KEY)]
    return {"outputs": outputs, "days": args.days, "notes": []}
