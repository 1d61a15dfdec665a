"""Forged pickles: each is refused or read within bounded time and memory, and nothing of it runs."""

from __future__ import annotations

import contextlib
import io
import pickle
import random
import resource
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.files import restricted_pickle
from solver_backend.body.files.restricted_pickle import read_pickle
from solver_backend.exchange.errors import BodyInvalid, UnsafePickle
from tests.support.pickle_bytes import array, attributes, pickled, sparse, stand_in, text

OBJECT_ARRAY = (
    b"\x80\x02cnumpy\nndarray\nK\x00\x85R(K\x01K\x03\x85cnumpy\ndtype\nX\x02\x00\x00\x00O8K\x00K\x01\x87R\x89]tb."
)
"""58 bytes that write to address 0 where NumPy's own ``__setstate__`` can be reached."""
DTYPE_STATE = (
    b"\x80\x02}X\x01\x00\x00\x00acnumpy\ndtype\nX\x02\x00\x00\x00f8K\x00K\x01\x87R"
    b"(K\x03X\x01\x00\x00\x00<NNNK\x7fK\x7fK\x00tbs."
)


def read(tmp_path: Path, content: bytes) -> dict[str, object]:
    path = tmp_path / "model.pkl"
    path.write_bytes(content)
    return read_pickle(path)


def test_an_honest_array_is_read(tmp_path: Path) -> None:
    values = np.arange(6, dtype="<f8")
    found = read(tmp_path, pickled(array(b"K\x02K\x03\x86", "f8", values.tobytes())))
    np.testing.assert_array_equal(found["v_template"], values.reshape(2, 3))


@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("values", [np.arange(5.0), np.array([[True, False]]), np.asfortranarray(np.eye(3, dtype="f4")),
                                    np.arange(3, dtype=">i4"), np.zeros((0, 4)), np.array(["a", "bc"])])  # fmt: skip
def test_what_numpy_pickles_is_read(tmp_path: Path, values: np.ndarray, protocol: int) -> None:
    found = read(
        tmp_path, pickle.dumps({"a": values, "b": values.dtype.type(values.flat[0]) if values.size else 1}, protocol)
    )
    np.testing.assert_array_equal(found["a"], values)
    assert np.asarray(found["a"]).dtype.kind == values.dtype.kind


def test_numpy_constructors_cannot_be_called_directly(tmp_path: Path) -> None:
    with pytest.raises(UnsafePickle, match=r"calls numpy\.ndarray in a way"):
        read(tmp_path, OBJECT_ARRAY)


@pytest.mark.parametrize("dtype", ["O8", "O", "V16", "f8,f8", "f999999999", "(2,2)f8", "M8[s]"])
def test_arrays_of_anything_but_numbers_are_refused(tmp_path: Path, dtype: str) -> None:
    with pytest.raises(BodyInvalid, match="plain numbers are expected"):
        read(tmp_path, pickled(array(b"K\x01\x85", dtype, b"\0" * 8)))


def test_forged_state_of_a_type_changes_nothing_but_the_byte_order(tmp_path: Path) -> None:
    with pytest.raises(UnsafePickle, match="sets the state of an object that has no state"):
        read(tmp_path, DTYPE_STATE.replace(b"X\x01\x00\x00\x00<", b"X\x01\x00\x00\x00X"))
    assert "a" in read(tmp_path, DTYPE_STATE)


@pytest.mark.parametrize(
    "shape", [b"K\x03\x85", b"J\xff\xff\xff\xff\x85", b"\x8a\x09" + b"\xff" * 8 + b"\x00\x85", b"]"]
)
def test_shapes_that_do_not_fit_their_bytes_are_named(tmp_path: Path, shape: bytes) -> None:
    with pytest.raises(BodyInvalid, match="cannot be read: an array"):
        read(tmp_path, pickled(array(shape, "f8", b"\0" * 16)))


def test_sparse_matrix_with_indices_outside_is_named(tmp_path: Path) -> None:
    found = read(tmp_path, sparse([0, 1], [0, 1, 2]))
    np.testing.assert_array_equal(found["v_template"], np.eye(2))
    wrong = [
        sparse([0, 7], [0, 1, 2]), sparse([0, 1], [0, 5, 2]), sparse([0, 1], [0, 1]),
        sparse([0, 1], [0, 1, 2], b"J\xff\xff\xff\x7f"),
    ]  # fmt: skip
    for content in wrong:
        with pytest.raises(BodyInvalid, match="inconsistent parts"):
            read(tmp_path, content)


def test_chumpy_without_a_state_is_named(tmp_path: Path) -> None:
    with pytest.raises(BodyInvalid, match="contains nothing, but 'x' or 'a' and 'idxs' are expected"):
        read(tmp_path, pickled(b"cchumpy.ch\nCh\n)\x81"))


def test_containers_that_hold_themselves_end(tmp_path: Path) -> None:
    with pytest.raises(BodyInvalid, match="cannot be read"):
        read(tmp_path, pickled(b"cchumpy.ch\nCh\n)\x81q\x00}" + text("x") + b"h\x00sb"))


def test_doubling_lists_and_tuples_are_not_followed(tmp_path: Path) -> None:
    doubled = b"]" + b"".join(b"q" + bytes([k]) + b"0]h" + bytes([k]) + b"ah" + bytes([k]) + b"a" for k in range(60))
    assert "v_template" not in read(tmp_path, pickled(doubled))
    key = b")" + b"".join(b"q" + bytes([k]) + b"0h" + bytes([k]) + b"h" + bytes([k]) + b"\x86" for k in range(60))
    with pytest.raises(BodyInvalid, match="a key that is not text or a number"):
        read(tmp_path, b"\x80\x02}" + key + b"Ns.")
    with pytest.raises(BodyInvalid, match="x is a list, but an array is expected"):
        read(tmp_path, pickled(stand_in("chumpy.ch\nCh", attributes(x=doubled))))


def test_one_text_turned_into_arrays_again_and_again_is_refused(tmp_path: Path) -> None:
    big = b"B" + struct.pack("<I", 1 << 22) + b"\0" * (1 << 22) + b"q\x00"
    one = array(b"J" + struct.pack("<i", 1 << 19) + b"\x85", "f8", b"").replace(b"B\0\0\0\0", b"h\x00")
    with pytest.raises(BodyInvalid, match="far more memory than the file size allows"):
        read(tmp_path, b"\x80\x02" + big + b"0]" + b"".join(one + b"a" for _ in range(40)) + b".")


def test_a_flood_of_operations_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restricted_pickle, "MAX_OPERATIONS", 1000)
    with pytest.raises(UnsafePickle, match="more than 1,000 operations"):
        read(tmp_path, b"\x80\x02" + b"N0" * 1000 + b"N.")


GREEDY = [
    b"", b"\x80", b".", b"N", b"]a.", b"(.", b"t.", b"h\x05.", b"r\xff\xff\xff\xff.", b"X\xff\xff\xff\x7fa.",
    b"\x8e" + b"\xff" * 7 + b"\x3f.", b"\x8b\xff\xff\xff\x7f.",
]  # fmt: skip


@pytest.mark.parametrize("content", GREEDY)
def test_broken_and_greedy_operations_are_named(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(BodyInvalid, match=r"cannot be read|contains a"):
        read(tmp_path, content)


@pytest.mark.slow
def test_a_child_with_little_memory_survives_every_forgery(tmp_path: Path) -> None:
    """Thousands of mutations in a process that may take 1 GB: only our errors come out."""
    honest = pickle.dumps({"a": np.arange(12.0).reshape(3, 4), "f": np.arange(6, dtype="u4"), "n": {"k": [1, "x"]}}, 2)
    seeds = [OBJECT_ARRAY, DTYPE_STATE, honest, pickled(array(b"K\x02\x85", "f8", b"\0" * 16))]
    path = tmp_path / "seeds.bin"
    path.write_bytes(pickle.dumps(seeds))
    done = subprocess.run(
        [sys.executable, "-c", "from tests.body.files.test_restricted_pickle import mutate; mutate()", str(path)],
        capture_output=True, text=True, timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31)),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout.split()[0]) == 6000


def mutate() -> None:
    """Read thousands of mutations of the seeds in ``sys.argv[1]`` and print how many there were."""
    seeds, rng = pickle.loads(Path(sys.argv[1]).read_bytes()), random.Random(0)
    path = Path(sys.argv[1]).with_name("mutant.pkl")
    for _ in range(6000):
        content = bytearray(rng.choice(seeds))
        for _ in range(rng.randint(1, 6)):
            place = rng.randrange(len(content))
            change = rng.random()
            if change < 0.6:
                content[place] = rng.randrange(256)
            elif change < 0.8:
                del content[place : place + rng.randint(1, 8)]
            else:
                content[place:place] = rng.choice(seeds)[: rng.randint(1, 40)]
            content = content or bytearray(b".")
        path.write_bytes(content)
        with contextlib.suppress(BodyInvalid, UnsafePickle):
            read_pickle(path)
    sys.stdout.write("6000\n")


def test_machine_reads_from_any_stream() -> None:
    assert restricted_pickle.Machine(io.BytesIO(pickle.dumps({"a": 1})), "x", frozenset()).load() == {"a": 1}
