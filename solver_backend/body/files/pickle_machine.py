"""A pickle interpreter that can build numbers, text, plain containers and arrays, and nothing else.

Python's own unpickler calls whatever a file names, and even NumPy's constructors can be made to write outside their
memory by a forged state. Here the operations (Python's ``pickletools``) are followed one by one: containers are filled,
arrays are made from a checked type, shape and bytes, and every other class than a few of old body files is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, BinaryIO

from solver_backend.body.files.pickled_arrays import (
    CALLS,
    Damage,
    NamedDtype,
    PickledName,
    UnbuiltArray,
    array_of,
    finished,
)
from solver_backend.exchange.errors import UnsafePickle

MAX_OPERATIONS = 2_000_000
"""A body model has thousands; each costs a microsecond and some hundred bytes at most."""
MIN_ALLOWANCE, ALLOWANCE = 2**26, 4
"""Bytes that arrays may take in all: so many, or so many times the file's own size."""
_KEEPS_ARGUMENT = frozenset({
    "INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT", "STRING", "BINSTRING",
    "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES",
    "BINBYTES8", "BYTEARRAY8",
})  # fmt: skip
_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None, "NEWTRUE": lambda: True, "NEWFALSE": lambda: False,
    "EMPTY_DICT": dict, "EMPTY_LIST": list, "EMPTY_TUPLE": tuple,
}  # fmt: skip


@dataclass
class StandIn:
    """An object of a known class, as the state it was pickled with; it never computes while a file is read."""

    kind: str
    """Module and name of its class."""
    state: dict[str, Any] = field(default_factory=dict)
    """Its attributes."""


class Machine:
    """Follows one pickle.

    Args:
        stream: the file, at its beginning.
        where: its name, for errors.
        classes: dotted names of the classes that become stand-ins.
    """

    def __init__(self, stream: BinaryIO | BytesIO, where: str, classes: frozenset[str]) -> None:
        self._stream, self._where, self._classes = stream, where, classes
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        size = stream.seek(0, 2)
        stream.seek(0)
        self._bytes_left = max(MIN_ALLOWANCE, ALLOWANCE * size)

    def load(self) -> Any:
        """Return what the pickle holds; arrays are finished, objects of known classes are stand-ins.

        Raises:
            UnsafePickle: it asks for a class or function that is not known, or has far too many operations.
            Damage, ValueError, IndexError, KeyError: it is damaged.
        """
        for count, (name, argument) in enumerate(self._operations()):
            if count > MAX_OPERATIONS:
                raise self._refusal(
                    f"The pickle has more than {MAX_OPERATIONS:,} operations; a body model has thousands."
                )
            if name == "STOP":
                return finished(self._pop())
            self._do(name, argument)
        raise Damage("the pickle has no end")

    def _operations(self) -> Iterator[tuple[str, Any]]:
        import pickletools  # only where somebody reads an old body file

        for operation, argument, _ in pickletools.genops(self._stream):
            yield operation.name, argument

    def _do(self, name: str, argument: Any) -> None:
        if name in _KEEPS_ARGUMENT:
            self._stack.append(argument)
        elif name in _CONSTANTS:
            self._stack.append(_CONSTANTS[name]())
        elif name in ("PROTO", "FRAME"):
            pass
        elif name == "MARK":
            self._marks.append(len(self._stack))
        elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
            self._memo[argument] = self._stack[-1]
        elif name == "MEMOIZE":
            self._memo[len(self._memo)] = self._stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            self._stack.append(self._memo[argument])
        elif name == "GLOBAL":
            self._name(*argument.split(" ", 1))
        else:
            method = getattr(self, "_" + name.lower(), None)
            if method is None:
                raise self._refusal(f"The pickle uses the operation {name}, which no body model holds.")
            method()

    # ---------------------------------------------------------------------------------------------- containers

    def _pop(self) -> Any:
        if len(self._stack) <= (self._marks[-1] if self._marks else 0):
            raise Damage("an operation finds nothing to work on")
        return self._stack.pop()

    def _since_mark(self) -> list[Any]:
        if not self._marks:
            raise Damage("a mark is missing")
        start = self._marks.pop()
        found = self._stack[start:]
        del self._stack[start:]
        return found

    def _of(self, kind: type) -> Any:
        """Return the top of the stack, which must be a list or dictionary to be filled."""
        if not self._stack or type(self._stack[-1]) is not kind:
            raise Damage(f"a {kind.__name__} is expected to be filled")
        return self._stack[-1]

    def _tuple(self) -> None:
        self._stack.append(tuple(self._since_mark()))

    def _tuple1(self) -> None:
        self._stack.append((self._pop(),))

    def _tuple2(self) -> None:
        second, first = self._pop(), self._pop()
        self._stack.append((first, second))

    def _tuple3(self) -> None:
        third, second, first = self._pop(), self._pop(), self._pop()
        self._stack.append((first, second, third))

    def _list(self) -> None:
        self._stack.append(self._since_mark())

    def _append(self) -> None:
        value = self._pop()
        self._of(list).append(value)

    def _appends(self) -> None:
        values = self._since_mark()
        self._of(list).extend(values)

    def _dict(self) -> None:
        values = self._since_mark()
        self._stack.append({})
        self._fill(values)

    def _setitem(self) -> None:
        value, key = self._pop(), self._pop()
        self._fill([key, value])

    def _setitems(self) -> None:
        self._fill(self._since_mark())

    def _fill(self, values: list[Any]) -> None:
        """Put keys and values into the dictionary on top; other keys than text and numbers could be costly to hash."""
        target = self._of(dict)
        for key, value in zip(values[::2], values[1::2], strict=True):
            if not isinstance(key, str | bytes | int):
                raise Damage("a dictionary has a key that is neither text nor a number")
            target[key] = value

    def _pop_mark(self) -> None:
        self._since_mark()

    # ------------------------------------------------------------------------------------------- names and calls

    def _stack_global(self) -> None:
        name, module = self._pop(), self._pop()
        if not isinstance(name, str) or not isinstance(module, str):
            raise Damage("the name of a class is not text")
        self._name(module, name)

    def _name(self, module: str, name: str) -> None:
        known = PickledName(module, name)
        if known.dotted not in self._classes and known.dotted not in CALLS:
            raise self._refusal(f"The pickle asks for {known.dotted}, which no body model holds; nothing was run.")
        self._stack.append(known)

    def _newobj(self) -> None:
        self._call(only_classes=True)

    def _reduce(self) -> None:
        self._call(only_classes=False)

    def _call(self, *, only_classes: bool) -> None:
        arguments, called = self._pop(), self._pop()
        if not isinstance(called, PickledName) or not isinstance(arguments, tuple):
            raise Damage("something is called that is not a function")
        call = CALLS.get(called.dotted)
        if called.dotted in self._classes and not arguments:
            self._stack.append(StandIn(called.dotted))
        elif only_classes or call is None:
            raise self._refusal(f"The pickle calls {called.dotted} in a way that a body model never does.")
        else:
            result = call(*arguments)
            self._spend(len(result) if isinstance(result, bytes) else 0)
            self._stack.append(result)

    def _spend(self, count: int) -> None:
        """Take so many bytes off what may still be built: one text can be turned into arrays again and again."""
        self._bytes_left -= count
        if self._bytes_left < 0:
            raise Damage("its arrays would take many times the file's own size")

    def _build(self) -> None:
        state = self._pop()
        target = self._stack[-1] if self._stack else None
        if isinstance(target, StandIn) and isinstance(state, dict):
            target.state = state
        elif isinstance(target, UnbuiltArray) and isinstance(state, tuple) and len(state) == 5:
            self._spend(len(state[4]) if isinstance(state[4], str | bytes | bytearray) else 0)
            target.values = array_of(*state[1:])
        elif isinstance(target, NamedDtype) and isinstance(state, tuple) and state[1:2] in (("<",), (">",), ("|",)):
            target.order = state[1]
        else:
            raise self._refusal("The pickle sets the state of something that has none in a body model.")

    def _refusal(self, message: str) -> UnsafePickle:
        return UnsafePickle(
            message, where=self._where,
            hint="Do not open this file with other tools; download the model again from its own site.",
        )  # fmt: skip
