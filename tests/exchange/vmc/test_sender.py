"""A receiver that is away or comes back is named once; addresses are read, and nothing leaves this machine unasked."""

from __future__ import annotations

import socket
import time

import pytest

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.vmc import sender as sender_module
from solver_backend.exchange.vmc.sender import PacketSender, VmcAddress, read_address


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("vmc://", "127.0.0.1", 39539), ("vmc://:39540", "127.0.0.1", 39540), ("vmc://stage-2", "stage-2", 39539),
        ("vmc://192.168.1.7:500/", "192.168.1.7", 500), ("vmc://[::1]:40000", "::1", 40000),
    ],
)  # fmt: skip
def test_addresses_are_read(text, host, port):
    assert read_address(text) == VmcAddress(host, port)
    assert read_address(str(read_address(text))) == VmcAddress(host, port)


@pytest.mark.parametrize(
    "text",
    ["", "127.0.0.1:39539", "vmc://a:0", "vmc://a:65536", "vmc://a:b", "vmc://a b", "osc://a", "vmc://a:1:2", "vmc:"],
)
def test_what_is_no_address_is_refused(text):
    with pytest.raises(CommandLineInvalid, match="vmc://HOST:PORT"):
        read_address(text)


def test_an_unknown_host_is_named():
    with pytest.raises(CommandLineInvalid, match="no-such-host"):
        PacketSender(VmcAddress("no-such-host.invalid"))


def receiver(port: int = 0) -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.bind(("127.0.0.1", port))
    found.settimeout(5.0)
    return found


def test_a_receiver_that_goes_and_comes_back_is_named_once_each_and_gets_every_packet(monkeypatch):
    monkeypatch.setattr(sender_module, "BACK_S", 0.05)
    there = receiver()
    port = there.getsockname()[1]
    sender = PacketSender(VmcAddress("127.0.0.1", port))
    assert sender.send(b"1") == "" and there.recv(10) == b"1"
    there.close()
    said = [sentence for _ in range(50) if (sentence := sender.send(b"away"))]
    assert len(said) == 1 and "No receiver" in said[0] and str(port) in said[0]
    back = receiver(port)
    said, got = [], []
    for number in range(40):
        said += [sentence for sentence in [sender.send(b"%d" % number)] if sentence]
        got.append(back.recv(10))
        time.sleep(0.005)
    assert got == [b"%d" % number for number in range(40)]
    assert said == [f"The receiver at vmc://127.0.0.1:{port} is back."]
    back.close()
    sender.close()
