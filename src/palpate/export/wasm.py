"""A module of WebAssembly from the object that LLVM emits: its functions become exports.

An object is a valid module already. The indices and addresses that a linker would replace are those of the object
alone, its data begin at address 0, and it imports memory, stack pointer and the functions of the C library. It has no
exports; its section ``linking`` has the names of its functions (WebAssembly tool conventions, Linking.md).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

PREAMBLE_BYTES = 8
CUSTOM_SECTION, EXPORT_SECTION, ELEMENT_SECTION, CODE_SECTION, DATA_SECTION, DATA_COUNT_SECTION = 0, 7, 9, 10, 11, 12
SYMBOL_TABLE, FUNCTION_SYMBOL, DATA_SYMBOL, SECTION_SYMBOL = 8, 0, 1, 3
UNDEFINED_FLAG, EXPLICIT_NAME_FLAG = 0x10, 0x40
FUNCTION_EXPORT, CONSTANT_ADDRESS, END_OF_EXPRESSION = 0, 0x41, 0x0B


class Module(NamedTuple):
    """A module, and the first address [B] behind its data."""

    content: bytes
    data_end: int


class _Reader:
    """Reads numbers and names of a section."""

    def __init__(self, content: bytes, at: int = 0) -> None:
        self.content, self.at = content, at

    def byte(self) -> int:
        self.at += 1
        return self.content[self.at - 1]

    def number(self) -> int:
        """Read an unsigned number in LEB128."""
        value, shift = 0, 0
        while True:
            byte = self.byte()
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    def signed(self) -> int:
        """Read a signed number in LEB128."""
        start = self.at
        value = self.number()
        bits = 7 * (self.at - start)
        return value - (1 << bits) if value >> (bits - 1) else value

    def read_bytes(self, count: int) -> bytes:
        self.at += count
        return self.content[self.at - count : self.at]

    def name(self) -> str:
        return self.read_bytes(self.number()).decode()


def module_of_object(content: bytes, names: Collection[str]) -> Module:
    """Return the module in which some functions of an object are exports."""
    sections = list(_sections(content))
    places: dict[str, int] = {}
    data_end = 0
    for kind, body in sections:
        if kind == CUSTOM_SECTION:
            reader = _Reader(body)
            if reader.name() == "linking":
                places |= _function_symbols(reader)
        elif kind == DATA_SECTION:
            data_end = _data_end(body)
    missing = [name for name in names if name not in places]
    if missing:
        raise RuntimeError(f"the object must have {', '.join(missing)}, got {len(places)} other functions")
    entries = [_named(name) + bytes([FUNCTION_EXPORT]) + _leb(places[name]) for name in names]
    exports = _section(EXPORT_SECTION, _leb(len(entries)) + b"".join(entries))
    standard = [(kind, body) for kind, body in sections if kind != CUSTOM_SECTION]
    later = (ELEMENT_SECTION, DATA_COUNT_SECTION, CODE_SECTION, DATA_SECTION)
    before = b"".join(_section(kind, body) for kind, body in standard if kind not in later)
    after = b"".join(_section(kind, body) for kind, body in standard if kind in later)
    return Module(content[:PREAMBLE_BYTES] + before + exports + after, data_end)


def _sections(content: bytes) -> Iterator[tuple[int, bytes]]:
    reader = _Reader(content, PREAMBLE_BYTES)
    while reader.at < len(content):
        kind = reader.byte()
        yield kind, reader.read_bytes(reader.number())


def _function_symbols(reader: _Reader) -> dict[str, int]:
    """Return the indices of the functions that an object defines, by name."""
    indices: dict[str, int] = {}
    reader.number()  # version
    while reader.at < len(reader.content):
        kind, size = reader.byte(), reader.number()
        end = reader.at + size
        for _ in range(reader.number() if kind == SYMBOL_TABLE else 0):
            symbol, flags = reader.byte(), reader.number()
            is_defined = not flags & UNDEFINED_FLAG
            if symbol == DATA_SYMBOL:
                reader.name()
                for _ in range(3 if is_defined else 0):
                    reader.number()
                continue
            index = reader.number()
            named = symbol != SECTION_SYMBOL and (is_defined or bool(flags & EXPLICIT_NAME_FLAG))
            name = reader.name() if named else ""
            if symbol == FUNCTION_SYMBOL and is_defined:
                indices[name] = index
        reader.at = end
    return indices


def _data_end(body: bytes) -> int:
    """Return the first address behind all active segments of data."""
    reader, end = _Reader(body), 0
    for _ in range(reader.number()):
        reader.number()  # flags: of memory 0, active
        start = reader.signed() if reader.byte() == CONSTANT_ADDRESS else 0
        if reader.byte() != END_OF_EXPRESSION:
            raise RuntimeError("addresses of data must be constants, got another expression; use another LLVM")
        size = reader.number()
        reader.read_bytes(size)
        end = max(end, start + size)
    return end


def _leb(value: int) -> bytes:
    """Return an unsigned number in LEB128."""
    parts = [value & 0x7F]
    while value := value >> 7:
        parts[-1] |= 0x80
        parts.append(value & 0x7F)
    return bytes(parts)


def _named(name: str) -> bytes:
    return _leb(len(name.encode())) + name.encode()


def _section(kind: int, body: bytes) -> bytes:
    return bytes([kind]) + _leb(len(body)) + body
