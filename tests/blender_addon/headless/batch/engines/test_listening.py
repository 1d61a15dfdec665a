"""Nothing of a batch listens beyond the loopback address, and nothing beyond it is spoken to without TLS."""

from __future__ import annotations

import os
import shutil
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("distributed")

from blender_addon._exchange.cluster_address import require_safe, use_certificates
from blender_addon._exchange.errors import FileMissing, SchedulerUnsafe
from blender_addon.headless.batch.engines.cluster import connected
from blender_addon.headless.main import main
from tests.support.tended_cluster import Tended

_LISTENING = "0A"  # State of a socket in ``/proc/net/tcp`` (Linux, ``include/net/tcp_states.h``).
_LOOPBACK = ("0100007F", "00000000000000000000000001000000", "0000000000000000FFFF00000100007F")


def listening(process: int) -> list[str]:
    """Return the addresses, in the system's hexadecimal, on which a process accepts connections."""
    if not Path("/proc/net/tcp").exists():
        pytest.skip("this system does not list its sockets")
    inodes = set()
    for link in Path(f"/proc/{process}/fd").iterdir():
        target = os.readlink(link)
        inodes |= {target[8:-1]} if target.startswith("socket:[") else set()
    rows = [row.split() for table in ("tcp", "tcp6") for row in Path("/proc/net", table).read_text().splitlines()[1:]]
    return [row[1].partition(":")[0] for row in rows if row[3] == _LISTENING and row[9] in inodes]


def test_scheduler_and_workers_listen_on_the_loopback_address_alone(tmp_path: Path) -> None:
    cluster = Tended(2, tmp_path)
    try:
        cluster.wait_for_workers(2)
        found = [listening(process.pid) for process in cluster.processes if process is not None]
        assert len(found) == 3 and all(found)
        assert {address for addresses in found for address in addresses} <= set(_LOOPBACK)
    finally:
        cluster.close()


@pytest.mark.parametrize("address", ["tcp://10.0.0.5:8786", "render1:8786", "tcp://[2001:db8::1]:8786", "0.0.0.0:1"])
def test_another_host_without_tls_is_refused(address: str, tmp_path: Path) -> None:
    with pytest.raises(SchedulerUnsafe, match="another host is not encrypted"):
        require_safe(address)
    (tmp_path / "scheduler.json").write_text(f'{{"address": "{address}"}}')
    with pytest.raises(SchedulerUnsafe):
        require_safe(str(tmp_path / "scheduler.json"))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:8786", "localhost:1", "tcp://[::1]:8786", "tls://10.0.0.5:8786"])
def test_this_machine_and_tls_are_accepted(address: str) -> None:
    require_safe(address)


def test_a_batch_on_another_host_is_refused_before_anything_is_sent(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "captures").mkdir()
    (tmp_path / "captures" / "a.npz").write_bytes(b"a")
    command = ["batch", str(tmp_path / "captures"), "--out", str(tmp_path / "out")]
    assert main([*command, "--scheduler", "tcp://192.0.2.1:8786", "--json"]) == 3
    assert "scheduler_unsafe" in capfd.readouterr().out
    assert main([*command, "--scheduler", "tls://192.0.2.1:8786", "--tls", str(tmp_path), "--json"]) == 3
    assert "does not contain ca.pem" in capfd.readouterr().out


def test_tls_without_certificates_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "captures").mkdir()
    (tmp_path / "captures" / "a.npz").write_bytes(b"a")
    command = ["batch", str(tmp_path / "captures"), "--out", str(tmp_path / "out"), "--json"]
    assert main([*command, "--scheduler", "tls://127.0.0.1:1"]) == 3
    found = capfd.readouterr().out
    assert "scheduler_unsafe" in found and "no certificates were specified" in found and "--tls FOLDER" in found


@pytest.fixture
def certificates(tmp_path: Path) -> Iterator[Path]:
    """A folder as the documentation makes it."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make certificates with")
    folder = tmp_path / "tls"
    folder.mkdir()
    command = "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=mocap -keyout key.pem -out cert.pem"
    subprocess.run(command.split(), check=True, cwd=folder, capture_output=True)
    shutil.copy(folder / "cert.pem", folder / "ca.pem")
    known = dict(os.environ)
    yield folder
    for name in set(os.environ) - set(known):
        del os.environ[name]


def answers(port: int, folder: Path, *, shows: bool) -> bool:
    """Return whether a scheduler sends anything to a client that trusts it, with a certificate of its own or without.

    Dask's first message comes unasked. Under TLS 1.3 who is refused learns it when reading.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.load_verify_locations(folder / "ca.pem")
    if shows:
        context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
    try:
        with (
            socket.create_connection(("127.0.0.1", port), timeout=30.0) as plain,
            context.wrap_socket(plain) as stream,
        ):
            return bool(stream.recv(1))
    except ssl.SSLError:
        return False


def test_a_scheduler_that_speaks_tls_is_reached_with_the_certificates(certificates: Path, tmp_path: Path) -> None:
    files = [f"--tls-{name}={certificates / file}" for name, file in (
        ("ca-file", "ca.pem"), ("cert", "cert.pem"), ("key", "key.pem"),
    )]  # fmt: skip
    scheduler = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--protocol", "tls", "--host", "127.0.0.1", "--port",
         "0", "--dashboard-address", "127.0.0.1:0", "--scheduler-file", str(tmp_path / "s.json"), *files],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        end = time.monotonic() + 60
        while not (tmp_path / "s.json").exists() and time.monotonic() < end:
            time.sleep(0.1)
        use_certificates(certificates)
        import dask.config

        dask.config.refresh()
        with connected(str(tmp_path / "s.json"), 30.0, lambda: None) as client:
            address = client.scheduler.address
            assert address.startswith("tls://127.0.0.1:")
        port = int(address.rpartition(":")[2])
        assert answers(port, certificates, shows=True)
        assert not answers(port, certificates, shows=False), "who shows no certificate is let in"
    finally:
        scheduler.terminate()
        scheduler.wait(30)
        for name in [name for name in os.environ if name.startswith("DASK_DISTRIBUTED__COMM")]:
            del os.environ[name]
        dask.config.refresh()


def test_a_folder_without_certificates_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileMissing, match=r"does not contain ca\.pem"):
        use_certificates(tmp_path)
