"""Images from and to files: textures as they are stored, renders as PNG; EXR is in :mod:`raytrace2.exr`."""

from __future__ import annotations

import io
import os
import struct
import warnings
import zlib
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, UnidentifiedImageError

from .errors import FileError
from .exr import read_exr_channels, read_exr_texture, write_exr
from .exr_header import MAGIC as _EXR_MAGIC
from .files import read_bytes, write_atomically

__all__ = ["ImageData", "linear_to_srgb", "read_exr_channels", "read_image", "srgb_to_linear", "write_exr", "write_png"]

_FORMATS = ("PNG", "JPEG", "BMP", "PPM", "TGA")
_REFUSED = {b"#?": "Radiance HDR", b"PF": "PFM", b"Pf": "PFM"}
_NOT_FINITE = (255, 0, 255)


class ImageData(NamedTuple):
    """``pixels`` (H, W, 1 or 3) uint8, float16 or float32, row 0 on top; ``is_srgb_encoded`` ones are uint8."""

    pixels: np.ndarray
    is_srgb_encoded: bool


def read_image(path: str | os.PathLike[str], *, raw: bool = False) -> ImageData:
    """The texture in ``path`` (png, jpg, bmp, ppm, tga, exr) stored as Mitsuba's bitmap texture stores it.

    8-bit images stay uint8, sRGB-encoded unless ``raw``; 16-bit PNG becomes float16, made linear unless ``raw``; EXR
    stays half or float. Alpha is left out. :class:`FileError` for damaged files, unknown formats and channels.
    """
    name = os.fspath(path)
    data = read_bytes(name)
    if data[:4] == _EXR_MAGIC:
        return ImageData(read_exr_texture(name), False)
    refused = _REFUSED.get(data[:2])
    if refused:
        raise FileError(f"{refused} images cannot be read", name, remedy="convert the image to OpenEXR")
    pixels = _decode(data, name)
    if pixels.dtype == np.uint16:
        encoded = pixels.astype(np.float32) / np.float32(65535)
        return ImageData((encoded if raw else srgb_to_linear(encoded)).astype(np.float16), False)
    return ImageData(pixels, not raw)


def write_png(path: str | os.PathLike[str], image: Any) -> None:
    """Write the linear ``image`` (H, W), (H, W, 1), (H, W, 3) or (H, W, 4) as 8-bit sRGB PNG; whole or not at all.

    Values are limited to [0, 1], as the format demands; pixels with NaN or infinity become magenta. Alpha is kept as it
    is. ``ValueError`` for other shapes; :class:`FileError` if the file cannot be written.
    """
    pixels = np.asarray(image, dtype=np.float64)
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3, 4) or 0 in pixels.shape:
        raise ValueError(f"an image of shape {pixels.shape} cannot be written as PNG: 1, 3 or 4 channels needed")
    colour, alpha = (pixels[:, :, :3], pixels[:, :, 3:]) if pixels.shape[2] == 4 else (pixels, pixels[:, :, :0])
    broken: np.ndarray = np.logical_not(np.isfinite(pixels).all(axis=2))
    limited = np.clip(np.where(broken[:, :, None], 0.0, colour), 0.0, 1.0)
    levels = np.repeat(linear_to_srgb(limited), 3 // limited.shape[2], axis=2) * 255 + 0.5
    opacity = np.where(broken[:, :, None], 1.0, np.clip(alpha, 0.0, 1.0)) * 255 + 0.5
    levels[broken] = _NOT_FINITE
    stream = io.BytesIO()
    Image.fromarray(np.concatenate([levels, opacity], axis=2).astype(np.uint8)).save(stream, "PNG")
    write_atomically(path, stream.getvalue())


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 decoding of values in [0, 1]."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 encoding of values in [0, 1]."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def _decode(data: bytes, name: str) -> np.ndarray:
    """(H, W, 1 or 3) uint8, or uint16 for PNG of that depth."""
    damaged = "the file is damaged; write it again"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            if data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) > 29 and data[24] == 16:
                return _decode_png16(data)
            with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
                if image.format == "PPM" and _ppm_levels(data) > 255:
                    raise FileError("PPM images of more than 8 bits cannot be read", name, remedy="convert it to PNG")
                if image.mode in ("L", "LA", "1"):
                    return np.array(image.convert("L"))[:, :, None]
                if image.mode in ("P", "PA"):
                    return np.array(image.convert("RGBA"))[:, :, :3]
                if image.mode in ("RGB", "RGBA", "RGBX"):
                    return np.array(image)[:, :, :3]
                message, remedy = f"images of mode {image.mode} cannot be read", "convert the image to RGB or gray"
    except FileError:
        raise
    except UnidentifiedImageError:
        message, remedy = "this is no image of a known format", "use png, jpg, bmp, ppm, tga or exr"
    except Image.DecompressionBombError:
        message, remedy = "the image has too many pixels", f"at most {2 * (Image.MAX_IMAGE_PIXELS or 0)} can be read"
    except Exception as error:  # damaged files bring all kinds of exceptions out of Pillow
        message, remedy = f"the image cannot be decoded: {str(error)[:200] or type(error).__name__}", damaged
    raise FileError(message, name, remedy=remedy)


def _decode_png16(data: bytes) -> np.ndarray:
    """Pillow keeps 16 bits of gray images only. Of the others it can be made to show either byte of each sample."""
    colour_type = data[25]
    if colour_type == 4:
        # Gray with alpha has the same bytes a pixel as 8-bit RGBA: relabelled, its R and G are the bytes of gray.
        header = b"IHDR" + data[16:24] + b"\x08\x06" + data[26:29]
        relabelled = data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]
        with Image.open(io.BytesIO(relabelled), formats=("PNG",)) as image:
            parts = np.array(image).astype(np.uint16)
        return parts[:, :, :1] << 8 | parts[:, :, 1:2]
    if colour_type == 0:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            return np.array(image).astype(np.uint16)[:, :, None]
    high, low = (_png_bytes(data, order) for order in "BL")
    return high.astype(np.uint16) << 8 | low


def _png_bytes(data: bytes, order: str) -> np.ndarray:
    """The more ("B") or the less ("L") significant bytes of 16-bit RGB or RGBA, (H, W, 3) uint8."""
    with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
        # PNG is big-endian; a decoder told that it is little-endian takes the other byte for the upper one.
        image.tile = [(*tile[:3], f"{image.mode};16{order}") for tile in image.tile]  # type: ignore[misc]
        return np.array(image)[:, :, :3]


def _ppm_levels(data: bytes) -> int:
    """The largest sample value that a PPM or PGM header (P2, P3, P5, P6) announces; 1 for bitmaps."""
    words = b" ".join(line.partition(b"#")[0] for line in data[:4096].split(b"\n")[:64]).split()[:4]
    return int(words[3]) if words[0] in (b"P2", b"P3", b"P5", b"P6") else 1
