"""OpenEXR images: textures in, renders with their provenance out and in again."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import OpenEXR

from .errors import FileError
from .exr_header import ExrHeader, read_exr_header
from .files import read_bytes, write_atomically

_REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
_RESERVED = {
    "channels", "chunkCount", "compression", "dataWindow", "displayWindow", "lineOrder", "name", "pixelAspectRatio",
    "screenWindowCenter", "screenWindowWidth", "tiles", "type", "version", "view",
}  # fmt: skip


def read_exr_texture(path: str | os.PathLike[str]) -> np.ndarray:
    """The colour of an EXR image: (H, W, 3) from R, G, B or (H, W, 1) from Y, float16 or float32 as stored.

    A layer prefix (``diffuse.R``) and an alpha channel, which is left out, are allowed. :class:`FileError` for other
    sets of channels, integers, subsampling, primaries other than Rec. 709, and pixels that are not finite.
    """
    name = os.fspath(path)
    data = read_bytes(name)
    header = read_exr_header(data, name)
    if header.chromaticities and np.abs(np.subtract(header.chromaticities, _REC709)).max() > 1e-3:
        remedy = "convert the image to Rec. 709 primaries"
        raise FileError("the image has primaries other than Rec. 709", name, remedy=remedy)
    by_suffix = {channel.rpartition(".")[2].lower(): channel for channel in header.channels}
    layers = {channel.rpartition(".")[0] for channel in header.channels}
    wanted = {frozenset("rgb"): "rgb", frozenset("rgba"): "rgb", frozenset("y"): "y", frozenset("ya"): "y"}
    order = wanted.get(frozenset(by_suffix))
    if order is None or len(layers) > 1 or len(by_suffix) < len(header.channels):
        message = f"cannot make colours of the channels {', '.join(header.channels)}"[:200]
        raise FileError(message, name, remedy="a texture needs R, G, B or Y, with or without A, and nothing else")
    channels, _ = _load(data, header, name)
    pixels = np.stack([channels[by_suffix[c]] for c in order], axis=-1)
    if pixels.dtype not in (np.float16, np.float32):
        raise FileError("the image holds integers", name, remedy="store it as half or float")
    bad = ~np.isfinite(pixels).all(axis=-1)
    if bad.any():
        y, x = np.unravel_index(int(np.argmax(bad)), bad.shape)
        message = f"pixel ({x}, {y}) is not finite: {' '.join(str(v) for v in pixels[y, x].tolist())}"
        raise FileError(message, name, remedy="replace NaN and infinite pixels; half cannot hold more than 65504")
    return pixels


def read_exr_channels(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """All channels of an EXR file by name, each (H, W), and the strings in its header; NaN and infinity are kept.

    :class:`FileError` if the file is damaged, deep, subsampled or of several parts.
    """
    name = os.fspath(path)
    data = read_bytes(name)
    return _load(data, read_exr_header(data, name), name)


def write_exr(
    path: str | os.PathLike[str], image: Any, channel_names: Sequence[str], metadata: Mapping[str, str] | None = None
) -> None:
    """Write ``image`` (H, W, C), or (H, W) for one channel, with ``metadata`` in the header; whole or not at all.

    float16 is written as half, everything else as float. ``ValueError`` if shape and ``channel_names`` do not fit or a
    metadata key is one that OpenEXR defines; :class:`FileError` if the file cannot be written.
    """
    pixels = np.asarray(image)
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.ndim != 3 or 0 in pixels.shape or pixels.shape[2] != len(channel_names):
        raise ValueError(f"an image of shape {pixels.shape} does not fit {len(channel_names)} channel names")
    if len(set(channel_names)) < len(channel_names) or not all(channel_names):
        raise ValueError(f"channel names must differ and not be empty: {', '.join(channel_names)}")
    if pixels.dtype != np.float16:
        pixels = pixels.astype(np.float32)
    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    for key, value in (metadata or {}).items():
        if key in _RESERVED or not key or not isinstance(value, str) or "\0" in key + value:
            raise ValueError(f"the metadata {key!r} cannot be written: a name of OpenEXR's own, or not a plain string")
        header[key] = value
    channels = {channel: np.ascontiguousarray(pixels[:, :, i]) for i, channel in enumerate(channel_names)}
    stream = io.BytesIO()
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(stream)
    except Exception as error:  # a name that is too long, or one for which OpenEXR wants something else than a string
        raise ValueError(f"OpenEXR cannot write these channels and metadata: {error}") from None
    write_atomically(path, stream.getvalue())


def _load(data: bytes, header: ExrHeader, name: str) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    subsampled = [channel for channel, sampling in header.channels.items() if sampling != (1, 1)]
    if subsampled:
        remedy = "write all channels in full resolution"
        raise FileError(f"the channel {subsampled[0]!r} is subsampled", name, remedy=remedy)
    try:
        with OpenEXR.File(io.BytesIO(data), separate_channels=True) as file:
            channels = {channel: np.array(c.pixels) for channel, c in file.channels().items()}
            strings = {key: value for key, value in file.header().items() if isinstance(value, str)}
    except Exception as error:  # the library raises whatever its C++ side threw
        reason = str(error) or type(error).__name__
        raise FileError(f"OpenEXR cannot read the file: {reason[:200]}", name, remedy="write it again") from None
    shape = (header.height, header.width)
    if set(channels) != set(header.channels) or any(c.shape != shape for c in channels.values()):
        raise FileError("the channels differ from what the header says", name, remedy="write the file again")
    return channels, strings
