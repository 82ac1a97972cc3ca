"""Reads a pickle as data. Nothing in it can run: there is nothing here that could run it.

A pickle is a program for a small stack machine, and the module `pickle` lets that program call functions. This machine
has no functions: a global is a `Name` (two strings) that must be on the caller's list, a call is a `Record` of that
name and its arguments. `pickletools`, which splits the file into operations, imports nothing on behalf of the file.
Python 2 files (protocols 0 to 2, text as latin-1) are understood, and those of protocols 3 and 4.
"""

from __future__ import annotations

import codecs
import io
import pickletools
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any

from jghand_engine.errors import InputError
from jghand_engine.limits import PICKLE_BYTES_MAX, PICKLE_OPERATIONS_MAX

_OPERATIONS = {operation.code: operation for operation in pickletools.opcodes}
# what Python 2 called modules that were renamed
_RENAMED = {"copy_reg": "copyreg", "__builtin__": "builtins"}


@dataclass(frozen=True)
class Name:
    """A global that the pickle mentions; never looked up."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


@dataclass
class Record:
    """What a call would have made: who was called, with what, and the state that was then put into it."""

    maker: Name
    arguments: tuple
    state: Any = None
    items: dict = field(default_factory=dict)
    elements: list = field(default_factory=list)


class _Mark:
    """The place on the stack where a tuple, list or dictionary begins."""


def read_pickle(data: bytes, allowed: Collection[Name], thing: str) -> Any:
    """The value that the pickle `data` describes, with `Name` and `Record` in the place of globals and objects.

    `thing` names the file in errors. InputError: a global that is not `allowed` (it is named), a broken or cut file, an
    operation that needs the outside world, a key that is no text, more than PICKLE_OPERATIONS_MAX operations, or calls
    that produce more than PICKLE_BYTES_MAX bytes.
    """
    return _Machine(allowed, thing).run(data)


class _Machine:
    def __init__(self, allowed: Collection[Name], thing: str) -> None:
        self.allowed, self.thing = allowed, thing
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self.produced_bytes = 0

    def run(self, data: bytes) -> Any:
        try:
            for count, (name, argument) in enumerate(_operations(data)):
                if count > PICKLE_OPERATIONS_MAX:
                    raise self.error(f"at most {PICKLE_OPERATIONS_MAX} operations", "more")
                if name == "STOP":
                    return self.pop()
                self.step(name, argument)
        # what the standard library's readers raise on bytes that are no pickle
        except (ValueError, IndexError, OverflowError, UnicodeError, SyntaxError) as error:
            raise self.error("a whole pickle", f"a broken one ({error})") from error
        raise self.error("a whole pickle", "one without an end")

    def error(self, wanted: str, came: str) -> InputError:
        return InputError(
            self.thing, wanted=wanted, came=came[:200], remedy="Nothing in it was executed. Use the original file."
        )

    def step(self, name: str, argument: Any) -> None:
        if name in _PUSH_ARGUMENT:
            self.stack.append(argument)
        elif name in _PUSH:
            self.stack.append(_PUSH[name]())
        elif name in _MEMO_PUT:
            place = len(self.memo) if argument is None else int(argument)
            # numbers chosen to collide would make the dictionary slow; real ones count up
            if not 0 <= place < PICKLE_OPERATIONS_MAX:
                raise self.error("a whole pickle", "one with a strange number in its memo")
            self.memo[place] = self.stack[-1]
        elif name in _MEMO_GET:
            if int(argument) not in self.memo:
                raise self.error("a whole pickle", "one that mentions what it never made")
            self.stack.append(self.memo[int(argument)])
        elif name in _STEPS:
            _STEPS[name](self, argument)
        elif name not in ("PROTO", "FRAME"):
            raise self.error("a pickle of arrays", f"one with the operation {name}")

    def pop(self) -> Any:
        value = self.stack.pop()
        if isinstance(value, _Mark):
            raise self.error("a whole pickle", "one with an empty stack")
        return value

    def pop_to_mark(self) -> list[Any]:
        for place in range(len(self.stack) - 1, -1, -1):
            if isinstance(self.stack[place], _Mark):
                values = self.stack[place + 1 :]
                del self.stack[place:]
                return values
        raise self.error("a whole pickle", "one with a list that never began")

    def name(self, module: Any, name: Any) -> Name:
        """The global as an inert name, if it is allowed. Every way to mention a global ends here."""
        if not isinstance(module, str) or not isinstance(name, str):
            raise self.error("a pickle of arrays", "a global without a name")
        found = Name(_RENAMED.get(module, module), name)
        if found not in self.allowed:
            raise self.error("arrays, and records of chumpy and scipy.sparse", f"the global {found!s:.200}")
        return found

    def call(self, maker: Any, arguments: Any) -> Any:
        if not isinstance(maker, Name) or not isinstance(arguments, tuple):
            raise self.error("a pickle of arrays", "a call of something that has no name")
        if maker in (Name("copyreg", "_reconstructor"), Name("copyreg", "__newobj__")):
            if not arguments:
                raise self.error("a pickle of arrays", "an object without a class")
            return self.call(arguments[0], ())
        if maker == Name("_codecs", "encode"):
            # how Python 3 writes bytes in old protocols
            if not arguments or not isinstance(arguments[0], str):
                raise self.error("a pickle of arrays", "bytes without text")
            # a short file can name one long text many times
            self.produced_bytes += len(arguments[0])
            if self.produced_bytes > PICKLE_BYTES_MAX:
                raise self.error(f"at most {PICKLE_BYTES_MAX} bytes", "more")
            return arguments[0].encode("latin-1")
        return Record(maker, arguments)

    def build(self, _: Any) -> None:
        state, target = self.pop(), self.stack[-1]
        if not isinstance(target, Record):
            raise self.error("a pickle of arrays", "a state for something that is no record")
        target.state = state

    def extend(self, values: list[Any]) -> None:
        target = self.stack[-1]
        if isinstance(target, Record):
            target = target.elements
        if not isinstance(target, list):
            raise self.error("a whole pickle", "elements of something that is no list")
        target.extend(values)

    def set_items(self, pairs: list[Any]) -> None:
        target = self.stack[-1]
        if isinstance(target, Record):
            target = target.items
        if not isinstance(target, dict) or len(pairs) % 2:
            raise self.error("a whole pickle", "items of something that is no dictionary")
        # hashes of text are salted; numbers can be chosen to collide, and nested tuples take for ever to hash
        if not all(isinstance(key, str) for key in pairs[::2]):
            raise self.error("text as keys", "others")
        target.update(zip(pairs[::2], pairs[1::2], strict=True))

    def tuple_of(self, count: int) -> None:
        values = [self.pop() for _ in range(count)][::-1]
        self.stack.append(tuple(values))

    def new_dict(self, _: Any) -> None:
        pairs = self.pop_to_mark()
        self.stack.append({})
        self.set_items(pairs)

    def inst(self, argument: str) -> None:
        module, name = argument.split(" ", 1)
        self.stack.append(self.call(self.name(module, name), tuple(self.pop_to_mark())))

    def obj(self, _: Any) -> None:
        maker, *arguments = self.pop_to_mark()
        self.stack.append(self.call(maker, tuple(arguments)))

    def reduce(self, _: Any) -> None:
        arguments, maker = self.pop(), self.pop()
        self.stack.append(self.call(maker, arguments))

    def stack_global(self, _: Any) -> None:
        name, module = self.pop(), self.pop()
        self.stack.append(self.name(module, name))


def _operations(data: bytes) -> Iterator[tuple[str, Any]]:
    """Names and arguments of the operations in `data`: `pickletools.genops`, but for one thing.

    Python 2's STRING operation carries bytes, which pickletools reads as ASCII and refuses in arrays; here they are
    latin-1. Reading from memory keeps a header that promises gigabytes from reserving any.
    """
    stream = io.BytesIO(data)
    while code := stream.read(1):
        operation = _OPERATIONS.get(code.decode("latin-1"))
        if operation is None:
            raise ValueError(f"unknown operation {code!r}")
        if operation.name == "STRING":
            raw = pickletools.read_stringnl(stream, decode=False)
            yield operation.name, codecs.escape_decode(raw)[0].decode("latin-1")
        else:
            yield operation.name, operation.arg.reader(stream) if operation.arg else None


_PUSH_ARGUMENT = frozenset(
    (
        *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
        *("STRING", "BINSTRING", "SHORT_BINSTRING", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8"),
        *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
    )
)
_PUSH: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_LIST": list,
    "EMPTY_SET": list,
    "EMPTY_DICT": dict,
    "EMPTY_TUPLE": tuple,
    "MARK": _Mark,
}
_MEMO_PUT = frozenset(("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"))
_MEMO_GET = frozenset(("GET", "BINGET", "LONG_BINGET"))
_STEPS: dict[str, Callable[[_Machine, Any], Any]] = {
    "GLOBAL": lambda machine, argument: machine.stack.append(machine.name(*argument.split(" ", 1))),
    "STACK_GLOBAL": _Machine.stack_global,
    "INST": _Machine.inst,
    "OBJ": _Machine.obj,
    "REDUCE": _Machine.reduce,
    "NEWOBJ": _Machine.reduce,
    "BUILD": _Machine.build,
    "TUPLE": lambda machine, _: machine.stack.append(tuple(machine.pop_to_mark())),
    "TUPLE1": lambda machine, _: machine.tuple_of(1),
    "TUPLE2": lambda machine, _: machine.tuple_of(2),
    "TUPLE3": lambda machine, _: machine.tuple_of(3),
    "LIST": lambda machine, _: machine.stack.append(machine.pop_to_mark()),
    "DICT": _Machine.new_dict,
    "APPEND": lambda machine, _: machine.extend([machine.pop()]),
    "APPENDS": lambda machine, _: machine.extend(machine.pop_to_mark()),
    "ADDITEMS": lambda machine, _: machine.extend(machine.pop_to_mark()),
    "FROZENSET": lambda machine, _: machine.stack.append(machine.pop_to_mark()),
    "SETITEM": lambda machine, _: machine.set_items([machine.pop(), machine.pop()][::-1]),
    "SETITEMS": lambda machine, _: machine.set_items(machine.pop_to_mark()),
    "POP": lambda machine, _: machine.stack.pop(),
    "POP_MARK": lambda machine, _: machine.pop_to_mark(),
    "DUP": lambda machine, _: machine.stack.append(machine.stack[-1]),
}
