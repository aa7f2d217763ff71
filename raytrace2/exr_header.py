"""The header of an OpenEXR file, checked in Python before the OpenEXR library allocates memory by what it says.

Layout: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from .errors import FileError

MAGIC = b"\x76\x2f\x31\x01"
_DEEP, _MULTIPART = 0x800, 0x1000
_PIXEL_BYTES = {0: 4, 1: 2, 2: 4}
# ZIP packs at best 1032 to 1; only small images can claim more without being made to exhaust memory.
_LARGE_IMAGE, _LARGEST_RATIO = 1 << 28, 2000
_DAMAGED = "the file is damaged; write it again"


@dataclass(frozen=True)
class ExrHeader:
    """``channels`` maps names to (x sampling, y sampling); ``chromaticities`` are those of the file, or None."""

    width: int
    height: int
    channels: dict[str, tuple[int, int]]
    chromaticities: tuple[float, ...] | None


def read_exr_header(data: bytes, name: str) -> ExrHeader:
    """The header of the single-part flat image ``data``; :class:`FileError` (naming ``name``) for anything else."""
    if data[:4] != MAGIC or len(data) < 8:
        raise FileError("not an OpenEXR file", name, remedy="check the file's type")
    (version,) = struct.unpack_from("<I", data, 4)
    if version & 0xFF != 2:
        raise FileError(f"OpenEXR version {version & 0xFF} cannot be read", name, remedy="write version 2")
    if version & _DEEP:
        raise FileError("deep OpenEXR images cannot be read", name, remedy="flatten the image")
    if version & _MULTIPART:
        raise FileError("OpenEXR files of several parts cannot be read", name, remedy="write one part to a file")
    try:
        attributes = _attributes(data)
        x0, y0, x1, y1 = struct.unpack("<4i", attributes["dataWindow"])
        channels, pixel_bytes = _channels(attributes["channels"])
        raw = attributes.get("chromaticities")
        chromaticities = struct.unpack("<8f", raw) if raw is not None else None
    except (KeyError, ValueError, IndexError, struct.error):
        raise FileError("the OpenEXR header is damaged", name, remedy=_DAMAGED) from None
    width, height = x1 - x0 + 1, y1 - y0 + 1
    size = width * height * pixel_bytes
    if width < 1 or height < 1 or not channels:
        message = f"the OpenEXR image is empty: {width} x {height} pixels, {len(channels)} channels"
        raise FileError(message, name, remedy=_DAMAGED)
    if size > _LARGE_IMAGE and size > len(data) * _LARGEST_RATIO:
        message = f"the header speaks of {width} x {height} pixels, in {len(data)} bytes"
        raise FileError(message, name, remedy=_DAMAGED)
    return ExrHeader(width, height, channels, chromaticities)


def _attributes(data: bytes) -> dict[str, bytes]:
    result: dict[str, bytes] = {}
    at = 8
    while data[at] != 0:
        end = data.index(b"\0", at, at + 256)
        type_end = data.index(b"\0", end + 1, end + 257)
        (size,) = struct.unpack_from("<i", data, type_end + 1)
        start = type_end + 5
        if size < 0 or start + size >= len(data):
            raise ValueError
        result[data[at:end].decode("utf-8", "backslashreplace")] = data[start : start + size]
        at = start + size
    return result


def _channels(raw: bytes) -> tuple[dict[str, tuple[int, int]], int]:
    """The sampling of each channel, and the bytes that one pixel of all of them takes."""
    result: dict[str, tuple[int, int]] = {}
    at = total = 0
    while raw[at] != 0:
        end = raw.index(b"\0", at)
        kind, _, x, y = struct.unpack_from("<4i", raw, end + 1)
        if x < 1 or y < 1:
            raise ValueError
        result[raw[at:end].decode("utf-8", "backslashreplace")] = (x, y)
        total += _PIXEL_BYTES[kind]
        at = end + 17
    return result, total
