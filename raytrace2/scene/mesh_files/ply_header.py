"""The header of a PLY file: which elements follow, how many of each, and the layout of one record.

As in Mitsuba, a list property stands for exactly three items (its record is a count and three values), so that every
element has records of one size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...errors import FileError

Encoding = Literal["ascii", "binary_little_endian", "binary_big_endian"]

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "long": "i8", "ulong": "u8", "half": "f2", "float16": "f2", "float32": "f4", "float64": "f8",
}  # fmt: skip
_REMEDY = "the header is damaged; export the mesh again"


@dataclass(frozen=True)
class Field:
    """One number of a record. ``role`` is ``"count"`` for the length of a list, ``"item"`` for its items."""

    name: str
    code: str
    role: Literal["value", "count", "item"] = "value"


@dataclass(frozen=True)
class Element:
    name: str
    count: int
    line: int
    fields: tuple[Field, ...]

    def dtype(self, order: str) -> np.dtype:
        """The packed record; its fields are called "0", "1", ... for names in files need not be unique or legal."""
        return np.dtype([(str(i), order + f.code) for i, f in enumerate(self.fields)])

    def index(self, name: str) -> int | None:
        """The position of the value called ``name``, or None."""
        return next((i for i, f in enumerate(self.fields) if f.role == "value" and f.name == name), None)


@dataclass(frozen=True)
class Header:
    """``body`` is the offset of the first byte after the header and ``body_line`` the number of its line."""

    encoding: Encoding
    elements: tuple[Element, ...]
    body: int
    body_line: int


def read_header(data: bytes, name: str) -> Header:
    """The header at the start of ``data``; :class:`FileError` names the file ``name`` and the line."""
    encoding: Encoding | None = None
    elements: list[Element] = []
    fields: list[Field] = []
    at, line = 0, 0

    def fail(message: str, remedy: str = _REMEDY) -> FileError:
        return FileError(message, name, line, remedy)

    def close() -> None:
        if elements:
            last = elements.pop()
            elements.append(Element(last.name, last.count, last.line, tuple(fields)))
            fields.clear()

    if data[:3] != b"ply":
        raise FileError("not a PLY file (it does not start with 'ply')", name, 1, "check the shape's type")
    while True:
        end = data.find(b"\n", at)
        line += 1
        if end < 0 or end - at > 4096:
            raise fail("the header does not end with 'end_header'")
        words = data[at:end].decode("ascii", "backslashreplace").split()
        at = end + 1
        match words:
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case ["ply"] if line == 1:
                pass
            case ["format", ("ascii" | "binary_little_endian" | "binary_big_endian") as word, "1.0"] if not encoding:
                encoding = word
            case ["element", word, count] if count.isdecimal() and len(count) <= 18 and encoding:
                close()
                if any(e.name == word for e in elements):
                    raise fail(f"a second element '{word}'")
                elements.append(Element(word, int(count), line, ()))
            case ["property", "list", count, item, word] if elements and count in _TYPES and item in _TYPES:
                if _TYPES[count][0] == "f":
                    raise fail(f"the length of list '{word}' is of type {count}", "use uchar or int")
                fields.append(Field(word, _TYPES[count], "count"))
                fields.extend(Field(word, _TYPES[item], "item") for _ in range(3))
            case ["property", code, word] if elements and code in _TYPES:
                if any(f.name == word and f.role == "value" for f in fields):
                    raise fail(f"a second property '{word}'")
                fields.append(Field(word, _TYPES[code]))
            case ["end_header"] if encoding:
                close()
                return Header(encoding, tuple(elements), at, line + 1)
            case _:
                raise fail(f"cannot read the header line '{' '.join(words)[:60]}'")
