"""Certificates by one command: whoever has the folder is let in, whoever has another's is not."""

from __future__ import annotations

import json
import shutil
import socket
import ssl
import stat
import threading
from pathlib import Path

import pytest

from blender_addon.headless import certificates
from blender_addon.headless.main import main

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="OpenSSL makes the certificates")


def made(folder: Path) -> Path:
    assert main(["certificates", "--out", str(folder), "--days", "2", "--json"]) == 0
    return folder


def context(folder: Path, kind: int) -> ssl.SSLContext:
    """As Dask has it: both sides show a certificate, host names are not compared."""
    found = ssl.SSLContext(kind)
    found.check_hostname, found.verify_mode = False, ssl.CERT_REQUIRED
    found.load_verify_locations(folder / "ca.pem")
    found.load_cert_chain(folder / "cert.pem", folder / "key.pem")
    return found


def let_in(server: Path, client: Path) -> bool:
    """Return whether a client with one folder is let in by a server with another."""
    ours, theirs = socket.socketpair()
    heard: list[bytes] = []

    def serve() -> None:
        try:
            with context(server, ssl.PROTOCOL_TLS_SERVER).wrap_socket(ours, server_side=True) as stream:
                heard.append(stream.recv(5))
        except (ssl.SSLError, OSError):
            ours.close()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        with context(client, ssl.PROTOCOL_TLS_CLIENT).wrap_socket(theirs) as stream:
            stream.sendall(b"hello")
    except (ssl.SSLError, OSError):
        theirs.close()
    thread.join(10.0)
    return heard == [b"hello"]


def test_who_has_the_folder_is_let_in(tmp_path: Path) -> None:
    ours, others = made(tmp_path / "ours"), made(tmp_path / "others")
    assert sorted(path.name for path in ours.iterdir()) == ["ca.pem", "cert.pem", "key.pem"]
    assert stat.S_IMODE((ours / "key.pem").stat().st_mode) == 0o600
    assert let_in(ours, ours) and not let_in(ours, others)


def test_a_key_that_is_there_is_kept(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = made(tmp_path / "tls")
    before = (folder / "key.pem").read_bytes()
    assert main(["certificates", "--out", str(folder), "--json"]) == 3
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["code"] == "output_exists"
    assert (folder / "key.pem").read_bytes() == before
    assert main(["certificates", "--out", str(folder), "--overwrite"]) == 0
    assert (folder / "key.pem").read_bytes() != before


def test_openssl_that_is_missing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(certificates.shutil, "which", lambda name: None)
    assert main(["certificates", "--out", str(tmp_path / "tls"), "--json"]) == 4
    assert json.loads(capfd.readouterr().out.splitlines()[-1])["code"] == "engine_missing"
    assert not (tmp_path / "tls").exists()
