"""Read pickles without running their code, for old SMPL files and network results."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from solver_backend.exchange.errors import BodyInvalid, UnsafePickle
from solver_backend.exchange.outputs import open_regular

MAX_DIMENSIONS = 8  # Largest number of dimensions of an array in a body file. SMPL's arrays have three.
_SIMPLE_DTYPE = re.compile(r"[<>|=]?(b1|[iu][1248]|f[248]|[SU]\d{1,4})")


class Damage(ValueError):
    """Inconsistency in a pickle. Callers report it to the user as an invalid body file."""


@dataclass(frozen=True)
class PickledName:
    """Class or function that the pickle names but that is never imported."""

    module: str
    name: str


@dataclass
class NamedDtype:
    """NumPy array type in a pickle, given by name and byte order."""

    spec: str
    order: Literal["<", ">", "=", "|"] = "="

    def dtype(self) -> np.dtype:
        """Return the NumPy type. Raise ``Damage`` unless it is for plain numbers or text."""
        if not _SIMPLE_DTYPE.fullmatch(self.spec):
            raise Damage(f"an array has the type {self.spec!r}, but plain numbers are expected")
        dtype = np.dtype(self.spec)
        return dtype.newbyteorder(self.order) if self.order in "<>" else dtype


class UnbuiltArray:
    """Array that the pickle has created but not filled. The operation BUILD sets ``values``."""

    values: Any = None


def finished(value: Any) -> Any:
    """Return the values of an ``UnbuiltArray``, or replace every ``UnbuiltArray`` in a dictionary by its values."""
    if isinstance(value, UnbuiltArray):
        if value.values is None:
            raise Damage("an array has no values")
        return value.values
    if isinstance(value, dict):
        return {key: finished(item) if isinstance(item, UnbuiltArray) else item for key, item in value.items()}
    return value


def array_of(shape: Any, dtype: Any, by_columns: Any, data: Any) -> np.ndarray:
    """Build an array of plain numbers from its pickled state, after checking its consistency."""
    if not isinstance(dtype, NamedDtype) or not isinstance(shape, tuple) or len(shape) > MAX_DIMENSIONS:
        raise Damage("an array's state is not valid")
    if not all(isinstance(size, int) and 0 <= size < 2**40 for size in shape):
        raise Damage(f"an array has the shape {shape}")
    if not isinstance(data, str | bytes | bytearray):
        raise Damage("an array's values are not bytes")
    plain, content = dtype.dtype(), data.encode("latin1") if isinstance(data, str) else bytes(data)
    if len(content) != prod(shape) * plain.itemsize:
        raise Damage(f"an array of shape {shape} and type {plain} has {len(content)} bytes")
    values = np.frombuffer(content, plain) if content else np.zeros(0, plain)
    return values.reshape(shape, order="F" if by_columns else "C").astype(plain.newbyteorder("="))


def _empty_array(kind: Any = None, *_: Any) -> UnbuiltArray:
    if kind != PickledName("numpy", "ndarray"):
        raise Damage("an array has an unknown class")
    return UnbuiltArray()


def _dtype(spec: Any = None, *_: Any) -> NamedDtype:
    if not isinstance(spec, str):
        raise Damage("an array's type is not text")
    return NamedDtype(spec)


def _encode(text: Any = None, encoding: Any = "latin1", *_: Any) -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        raise UnsafePickle(f"The pickle asks for the text encoding {encoding!r}. Body files use only latin1.")
    return text.encode("latin1")


CALLS: dict[str, Callable[..., Any] | None] = {  # Functions that a pickle may call.
    "numpy.ndarray": None,
    "numpy.dtype": _dtype,
    "_codecs.encode": _encode,
    **dict.fromkeys(("builtins.bytes", "__builtin__.bytes"), lambda: b""),
}
for _module in ("numpy.core.multiarray", "numpy._core.multiarray"):
    CALLS[f"{_module}._reconstruct"] = _empty_array
    CALLS[f"{_module}.scalar"] = lambda dtype=None, data=None, *_: array_of((1,), dtype, False, data)[0]


MIN_ALLOWANCE, ALLOWANCE = 2**26, 4  # Bytes allowed for arrays: this minimum, or this multiple of the file size.
_KEEPS_ARGUMENT = re.compile(r"(SHORT_)?(BIN)?(INT|LONG|FLOAT|STRING|UNICODE|BYTES|BYTEARRAY)\d?")
"""Operations that push their argument onto the stack."""
_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_DICT": dict,
    "EMPTY_LIST": list,
    "EMPTY_TUPLE": tuple,
}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}  # Number of stack items that each operation takes.


@dataclass
class StandIn:
    """Placeholder for a known object, with its pickled state. The object's code is never run."""

    kind: str
    state: dict[str, Any] = field(default_factory=dict)


MAX_OPERATIONS = 2_000_000  # A body model needs thousands. Each takes a microsecond and at most a few hundred bytes.


@dataclass(frozen=True)
class Dialect:
    """Functions, limits and messages that are specific to the pickles of one program."""

    calls: dict[str, Callable[..., Any] | None] = field(default_factory=dict)  # Additional functions, see ``CALLS``.
    persistent: Callable[[Any], Any] | None = None  # Resolves a persistent id. None if there are no ids.
    inline: Callable[[StandIn, BinaryIO | BytesIO], Any] | None = None
    """Reads data that follows a known object in the stream, and returns its replacement."""
    objects: bool = False  # Whether arrays of objects become lists.
    most: int = 0  # Largest number of operations, or 0 for ``MAX_OPERATIONS``.
    kind: str = "body model"  # Type of file, for messages.
    remedy: str = "Download the body model again from its official site"  # Advice if a file is rejected.
    least: int = MIN_ALLOWANCE  # Bytes allowed for the arrays in a small file.


class Machine:
    """Pickle interpreter that runs no code. Objects of the ``classes`` (dotted names) become placeholders."""

    def __init__(
        self, stream: BinaryIO | BytesIO, where: str, classes: frozenset[str], dialect: Dialect | None = None
    ) -> None:
        self._stream, self._where, self._classes = stream, where, classes
        self._dialect = Dialect() if dialect is None else dialect
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        size = stream.seek(0, 2)
        stream.seek(0)
        self._bytes_left = max(self._dialect.least, ALLOWANCE * size)

    def load(self) -> Any:
        """Interpret the pickle and return its content, with placeholders for objects of known classes.

        Raises:
            UnsafePickle: the pickle requests an unknown class or function, or has far too many operations.
            Damage, ValueError, IndexError, KeyError: the pickle is damaged.
        """
        import pickletools  # needed only for old body files

        most = self._dialect.most or MAX_OPERATIONS
        for count, (operation, argument, _) in enumerate(pickletools.genops(self._stream)):
            if count > most:
                many = f"The pickle has more than {most:,} operations. A {self._dialect.kind} has only thousands."
                raise self._refusal(many)
            if operation.name == "STOP":
                return finished(*self._pop(1))
            self._do(operation.name, argument)
        raise Damage("the pickle has no end")

    def _do(self, name: str, argument: Any) -> None:
        stack = self._stack
        if _KEEPS_ARGUMENT.fullmatch(name):
            stack.append(argument)
        elif name in _CONSTANTS:
            stack.append(_CONSTANTS[name]())
        elif name in _TUPLES:
            stack.append(tuple(self._pop(_TUPLES[name])))
        elif name in ("TUPLE", "LIST"):
            stack.append(tuple(self._since_mark()) if name == "TUPLE" else self._since_mark())
        elif name in ("APPEND", "APPENDS"):
            values = self._pop(1) if name == "APPEND" else self._since_mark()
            self._top(list).extend(values)
        elif name in ("DICT", "SETITEM", "SETITEMS"):
            values = self._pop(2) if name == "SETITEM" else self._since_mark()
            stack += [{}] if name == "DICT" else []
            self._fill(values)
        elif name == "MARK":
            self._marks.append(len(stack))
        elif name == "POP_MARK":
            self._since_mark()
        elif name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
            self._memo[len(self._memo) if name == "MEMOIZE" else argument] = stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            stack.append(self._memo[argument])
        elif name in ("GLOBAL", "STACK_GLOBAL"):
            self._name(*(argument.split(" ", 1) if name == "GLOBAL" else self._pop(2)))
        elif name in ("NEWOBJ", "REDUCE"):
            self._call(*self._pop(2), only_classes=name == "NEWOBJ")
        elif name == "BUILD":
            self._build(*self._pop(1))
        elif name == "POP":
            self._pop(1)
        elif name == "BINPERSID" and self._dialect.persistent is not None:
            stack.append(self._dialect.persistent(self._pop(1)[0]))
        elif name not in ("PROTO", "FRAME"):
            raise self._refusal(f"The pickle uses the operation {name}, which no {self._dialect.kind} contains.")

    def _pop(self, count: int) -> list[Any]:
        if len(self._stack) - count < (self._marks[-1] if self._marks else 0):
            raise Damage("an operation finds nothing to work on")
        found = self._stack[-count:]
        del self._stack[-count:]
        return found

    def _since_mark(self) -> list[Any]:
        if not self._marks:
            raise Damage("a mark is missing")
        start = self._marks.pop()
        found = self._stack[start:]
        del self._stack[start:]
        return found

    def _top(self, kind: type) -> Any:
        if not self._stack or type(self._stack[-1]) is not kind:
            raise Damage(f"a {kind.__name__} is expected to be filled")
        return self._stack[-1]

    def _fill(self, values: list[Any]) -> None:
        """Add keys and values to the dictionary on the stack. Keys must be text, bytes or numbers, which hash fast."""
        target = self._top(dict)
        for key, value in zip(values[::2], values[1::2], strict=True):
            if not isinstance(key, str | bytes | int | np.integer):
                raise Damage("a dictionary has a key that is not text or a number")
            target[key] = value

    def _name(self, module: Any, name: Any) -> None:
        if not isinstance(name, str) or not isinstance(module, str):
            raise Damage("the name of a class is not text")
        dotted = f"{module}.{name}"
        if dotted not in self._classes and dotted not in CALLS and dotted not in self._dialect.calls:
            wrong = f"The pickle asks for {dotted}, which no {self._dialect.kind} contains."
            raise self._refusal(f"{wrong} No code was run.")
        self._stack.append(PickledName(module, name))

    def _call(self, called: Any, arguments: Any, *, only_classes: bool) -> None:
        if not isinstance(called, PickledName) or not isinstance(arguments, tuple):
            raise Damage("a value that is not a function is called")
        dotted = f"{called.module}.{called.name}"
        call = self._dialect.calls.get(dotted, CALLS.get(dotted))
        if dotted in self._classes and not arguments:
            self._stack.append(StandIn(dotted))
        elif only_classes or call is None:
            raise self._refusal(f"The pickle calls {dotted} in a way that a {self._dialect.kind} never does.")
        else:
            for argument in arguments:
                self._spend(None if isinstance(argument, str) else argument)
            result = call(*arguments)
            self._spend(result)
            self._stack.append(result)

    def _spend(self, content: Any) -> None:
        """Count the bytes of an array against the limit, because a pickle can use the same bytes for many arrays."""
        self._bytes_left -= len(content) if isinstance(content, str | bytes | bytearray) else 0
        if self._bytes_left < 0:
            raise Damage("its arrays would need far more memory than the file size allows")

    def _build(self, state: Any) -> None:
        target = self._stack[-1] if self._stack else None
        if isinstance(target, StandIn) and isinstance(state, dict):
            target.state = state
            if self._dialect.inline is not None:
                self._stack[-1] = self._dialect.inline(target, self._stream)
        elif isinstance(target, UnbuiltArray) and isinstance(state, tuple) and len(state) == 5:
            self._spend(state[4])
            of_objects = self._dialect.objects and isinstance(state[4], list)
            target.values = state[4] if of_objects else array_of(*state[1:])
        elif isinstance(target, NamedDtype) and isinstance(state, tuple) and state[1:2] in (("<",), (">",), ("|",)):
            target.order = state[1]
        else:
            raise self._refusal(f"The pickle sets the state of an object that has no state in a {self._dialect.kind}.")

    def _refusal(self, message: str) -> UnsafePickle:
        hint = f"Do not open this file with other tools. {self._dialect.remedy}."
        return UnsafePickle(message, where=self._where, hint=hint)


MAX_ELEMENTS = 50_000_000  # Most elements of a sparse matrix. The family's largest joint regressor has 0.6 million.
_CHUMPY = frozenset({"chumpy.ch.Ch", "chumpy.reordering.Select"})
_SPARSE = frozenset({"scipy.sparse.csc.csc_matrix", "scipy.sparse._csc.csc_matrix"})
_DAMAGE = (OSError, EOFError, ValueError, TypeError, KeyError, IndexError, OverflowError, RecursionError, MemoryError)


def read_pickle(path: Path) -> dict[str, Any]:
    """Read the arrays, texts and numbers in a pickled body model.

    Raises:
        UnsafePickle: the file requests a class or function other than array constructors.
        BodyInvalid: the file is damaged or is not a dictionary.
    """
    try:
        with open_regular(path) as stream:
            content = Machine(stream, str(path), _CHUMPY | _SPARSE).load()
        if isinstance(content, dict):
            values = {str(key): _plain(value) for key, value in content.items()}
            return {key: value for key, value in values.items() if not isinstance(value, list | tuple | dict)}
    except (UnsafePickle, BodyInvalid):
        raise
    except _DAMAGE as error:
        hint = "The file may be truncated. Copy or download it again."
        raise BodyInvalid(f"The pickle cannot be read: {error}", where=str(path), hint=hint) from error
    raise BodyInvalid(f"The pickle contains a {type(content).__name__}, but a dictionary is expected.", where=str(path))


def _plain(value: Any) -> Any:
    if isinstance(value, StandIn):
        return _chumpy(value.state) if value.kind in _CHUMPY else _sparse_columns(value.state)
    return finished(value)


def _chumpy(state: dict[str, Any]) -> np.ndarray:
    """Return a chumpy object's array: the attribute ``x``, or the elements of the attribute ``a`` at ``idxs``."""
    if "x" in state:
        return _member(state, "x")
    if "a" in state and "idxs" in state:
        chosen = _member(state, "a").reshape(-1)[_member(state, "idxs")]
        shape = finished(state.get("preferred_shape"))
        return chosen if shape is None else chosen.reshape(tuple(int(size) for size in shape))
    held = ", ".join(sorted(map(str, state))) or "nothing"
    hint = "Convert the file to .npz with the vendor's own tool."
    raise BodyInvalid(f"A chumpy array contains {held}, but 'x' or 'a' and 'idxs' are expected.", hint=hint)


def _sparse_columns(state: dict[str, Any]) -> np.ndarray:
    """Convert a pickled SciPy compressed sparse column matrix to a dense array."""
    rows, columns = (int(size) for size in state.get("_shape") or state["shape"])
    data, indices, pointers = (_member(state, name) for name in ("data", "indices", "indptr"))
    sound = (
        0 <= rows * columns <= MAX_ELEMENTS
        and rows >= 0
        and pointers.shape == (columns + 1,)
        and data.ndim == indices.ndim == 1
        and len(data) == len(indices) == pointers[-1]
        and pointers[0] == 0
        and bool((np.diff(pointers.astype(np.int64)) >= 0).all())
        and bool(((indices >= 0) & (indices < rows)).all())
    )
    if not sound:
        hint = "The file may be truncated. Download the model again."
        raise BodyInvalid(f"A sparse matrix of {rows} x {columns} has inconsistent parts.", hint=hint)
    dense = np.zeros((rows, columns))
    dense[indices, np.repeat(np.arange(columns), np.diff(pointers.astype(np.int64)))] = data
    return dense


def _member(state: dict[str, Any], name: str) -> np.ndarray:
    """Return an array from a placeholder's state. Lists are rejected, because they can be nested without limit."""
    value = _plain(state[name])
    if not isinstance(value, np.ndarray):
        raise ValueError(f"{name} is a {type(value).__name__}, but an array is expected")
    return value
