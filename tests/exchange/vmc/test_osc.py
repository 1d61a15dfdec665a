"""Packets have the bytes that the specification and python-osc have, and nothing that comes is taken for more."""

from __future__ import annotations

import random
import struct

import pytest

from solver_backend.exchange.vmc.osc import PacketInvalid, decode_packet, encode_bundle, encode_message

GOLDEN = {
    ("/VMC/Ext/OK", (1,)): "2f564d432f4578742f4f4b002c69000000000001",
    ("/VMC/Ext/T", (12.5,)): "2f564d432f4578742f5400002c66000041480000",
    ("/abc", ()): "2f616263000000002c000000",
    ("/a", ("Hips", "Grüße", 0.25, -7, b"\1\2\3", True, False, None)): (
        "2f6100002c73736669625446" + "4e000000" + "4869707300000000" + "4772c3bcc39f6500" + "3e800000fffffff9"
        "0000000301020300"
    ),
}
"""What python-osc 1.10.2 writes."""
MIXED = ("Hips", 0.1, -0.0, 1e-30, 2**31 - 1, 1 - 2**31, b"1", b"12345", True, None, "")


@pytest.mark.parametrize(("message", "expected"), GOLDEN.items(), ids=lambda value: str(value)[:20])
def test_messages_have_python_oscs_bytes(message, expected):
    assert encode_message(*message).hex() == expected


def test_messages_and_bundles_are_python_oscs_where_it_is_installed():
    builder = pytest.importorskip("pythonosc.osc_message_builder", reason="python-osc is not installed")
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder

    rng = random.Random(0)
    bundle, ours = OscBundleBuilder(IMMEDIATELY), []
    for _ in range(200):
        address = "/" + "x" * rng.randrange(20)
        values = [rng.choice([*MIXED, rng.uniform(-1e6, 1e6), "y" * rng.randrange(9)]) for _ in range(rng.randrange(9))]
        message = builder.OscMessageBuilder(address)
        for value in values:
            message.add_arg(value)
        theirs = message.build()
        ours.append(encode_message(address, values))
        assert ours[-1] == theirs.dgram
        bundle.add_content(theirs)
    assert encode_bundle(ours) == bundle.build().dgram


def test_what_was_written_is_read():
    float32 = struct.unpack(">f", struct.pack(">f", 0.1))[0]
    message = encode_message("/a/b", ("Hips", float32, -3, b"123", True, False, None, ""))
    read = decode_packet(encode_bundle([message, encode_bundle([encode_message("/c", ()), message])]))
    assert [m.address for m in read] == ["/a/b", "/c", "/a/b"]
    assert read[0].values == read[2].values == ("Hips", float32, -3, b"123", True, False, None, "")
    assert decode_packet(message)[0].address == "/a/b"
    assert decode_packet(b"/old\0\0\0\0")[0].values == ()


@pytest.mark.parametrize(
    "packet",
    [
        b"", b"/", b"abc\0", b"#bundle\0", b"#bundle\0" + bytes(8) + b"\0\0\0\x08/a\0\0",
        b"#bundle\0" + bytes(8) + struct.pack(">i", -4) + b"abcd", b"#bundle\0" + bytes(8) + struct.pack(">i", 0),
        b"/a\0\0abc\0", b"/a\0\0,i\0\0", b"/a\0\0,x\0\0", b"/a\0\0,b\0\0\x7f\xff\xff\xff", b"/a\0\0,s\0\0abc",
        b"/a\0\0,b\0\0\xff\xff\xff\xff", b"/a\0",
    ],
)  # fmt: skip
def test_packets_that_are_none_are_refused_by_name(packet):
    with pytest.raises(PacketInvalid, match="."):
        decode_packet(packet)


def test_bundles_inside_each_other_have_an_end():
    packet = encode_message("/a")
    for _ in range(3000):
        packet = encode_bundle([packet])
    with pytest.raises(PacketInvalid, match="deep"):
        decode_packet(packet)


def test_a_packet_cut_anywhere_is_refused_or_read():
    whole = encode_bundle([encode_message("/VMC/Ext/Bone/Pos", ["Hips", *[0.5] * 7])] * 3)
    refused = 0
    for end in range(len(whole)):
        try:
            assert len(decode_packet(whole[:end])) < 3
        except PacketInvalid:
            refused += 1
    assert refused > len(whole) - 5


@pytest.mark.parametrize(("values", "said"), [((2**31,), "32 bits"), (("a\0b",), "null")])
def test_what_cannot_be_written_is_refused(values, said):
    with pytest.raises(ValueError, match=said):
        encode_message("/a", values)
