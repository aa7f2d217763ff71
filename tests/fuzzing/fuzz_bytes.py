# ruff: noqa: E501 -- a case a line
"""Damage to files: what a bad disk, a broken exporter or an enemy does to bytes."""

from __future__ import annotations

import random
import re
import struct

NUMBERS = (
    "nan", "-nan", "inf", "-inf", "1e400", "-1e400", "1e39", "1e38", "3e30", "-1", "0", "-0", "1e-46", "1e-320", "", "x", "0x10",
    "1,5", "1e", "9" * 40, "-" + "9" * 400, "2147483647", "2147483648", "4294967295", "4294967296", "4294967297",
    "-2147483649", "9223372036854775807", "9223372036854775808", "-9223372036854775808", "18446744073709551616",
    "1000000000", "1000000000000", "0.5", "1e-30", "1e30", "180", "-180", "1_000", "١", "1 2", "1 2 3", "true", "1.0f",
)  # fmt: skip

_TOKEN = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?|[A-Za-z_]+")


def four_bytes(data: bytes, rng: random.Random, start: int = 0) -> bytes:
    """``data`` with four bytes from ``start`` on replaced by others."""
    out = bytearray(data)
    for _ in range(4):
        at = rng.randrange(start, len(out))
        out[at] = (out[at] + rng.randrange(1, 256)) % 256
    return bytes(out)


def damaged(data: bytes, rng: random.Random) -> bytes:
    """``data`` after one to three random accidents."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(_ACCIDENTS)(data, rng) if data else data
    return data


def _flip_bit(data: bytes, rng: random.Random) -> bytes:
    out = bytearray(data)
    out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _insert(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.choice((1, 2, 4, 100))) + data[at:]


def _delete(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + data[at + rng.choice((1, 2, 4, 16, 100)) :]


def _splice(data: bytes, rng: random.Random) -> bytes:
    a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[a:b] + data[at:] if rng.random() < 0.5 else data[:at] + data[a:b]


def _word(data: bytes, rng: random.Random) -> bytes:
    """Four aligned or unaligned bytes become a number at the edge of some type."""
    code = rng.choice(("<I", ">I", "<i", "<f", ">f", "<H", "<Q"))
    numbers = (
        (float("nan"), float("inf"), 1e38, -1e38, 1e-40, 0.0) if code[1] == "f"
        else (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF)[: 6] if code[1] == "H"
        else (0, 1, 3, 0x7FFFFFFF) if code[1] == "i"
        else (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
    )  # fmt: skip
    new = struct.pack(code, rng.choice(numbers))
    at = rng.randrange(max(1, len(data) - len(new)))
    return data[:at] + new + data[at + len(new) :]


def _token(data: bytes, rng: random.Random) -> bytes:
    """A number or a word in a text, or in a header, becomes another."""
    found = list(_TOKEN.finditer(data[:4096]))
    if not found:
        return data
    match = rng.choice(found)
    new = rng.choice(NUMBERS).encode() if rng.random() < 0.7 else rng.choice(found)[0]
    return data[: match.start()] + new + data[match.end() :]


def _lines(data: bytes, rng: random.Random) -> bytes:
    """A line is lost, repeated or moved."""
    lines = data.split(b"\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(3):
        case 0:
            del lines[a]
        case 1:
            lines.insert(b, lines[a])
        case _:
            lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


def _fill(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    size = rng.choice((4, 16, 64))
    return data[:at] + rng.choice((b"\0", b"\xff")) * len(data[at : at + size]) + data[at + size :]


_ACCIDENTS = (
    four_bytes,
    four_bytes,
    _flip_bit,
    _truncate,
    _insert,
    _delete,
    _splice,
    _word,
    _token,
    _token,
    _lines,
    _fill,
)
