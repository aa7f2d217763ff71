"""Images in the storage that textures and environment maps have: 1 or 3 channels, and sRGB only in 8 bits."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from .reading import Reading


def load_pixels(path: str, raw: bool, reading: Reading) -> tuple[np.ndarray, bool]:
    """The image file ``path`` and whether its values are sRGB-encoded (never if ``raw``); read once per scene."""
    from ..image_io import read_image

    key = (os.path.abspath(path), raw)
    if key not in reading.files:
        reading.files[key] = read_image(path, raw=raw)
    pixels, encoded = reading.files[key]
    return pixels, encoded


def from_live(image: Any) -> tuple[np.ndarray, bool]:
    """The pixels of a ``mi.Bitmap``, a tensor or a NumPy array, and whether they are sRGB-encoded."""
    encoded = bool(image.srgb_gamma()) if hasattr(image, "srgb_gamma") else False
    return np.array(image), encoded


def store_as_texture(pixels: np.ndarray, encoded: bool) -> tuple[np.ndarray, bool]:
    """``pixels`` (h, w) or (h, w, c) as (h, w, 1 or 3) in uint8, float16 or float32, and whether still encoded.

    As in Mitsuba, alpha is dropped; 8-bit pixels stay as they are and decode on lookup; 16-bit integers become linear
    float16; float64 becomes float32. ``ValueError`` for shapes and types that are no image.
    """
    pixels = _color_channels(pixels)
    if pixels.dtype == np.uint8:
        return pixels, encoded
    if pixels.dtype in (np.float16, np.float32) and not encoded:
        return pixels, False
    stored = np.float16 if pixels.dtype.itemsize == 2 else np.float32
    return _linear(pixels, encoded).astype(stored), False


def store_as_environment(pixels: np.ndarray, encoded: bool) -> np.ndarray:
    """``pixels`` as linear float32 (h, w, 3), grey repeated; small ones repeat their edge until they are 2 x 3."""
    pixels = _linear(_color_channels(pixels), encoded).astype(np.float32)
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    rows, columns = max(3 - pixels.shape[0], 0), max(2 - pixels.shape[1], 0)
    return np.pad(pixels, ((0, rows), (0, columns), (0, 0)), mode="edge") if rows or columns else pixels


def _color_channels(pixels: np.ndarray) -> np.ndarray:
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.ndim != 3 or 0 in pixels.shape or pixels.shape[2] > 4:
        raise ValueError(f"an image has height, width and 1 to 4 channels, not the shape {pixels.shape}")
    if pixels.dtype not in (np.uint8, np.uint16, np.uint32, np.float16, np.float32, np.float64):
        raise ValueError(f"an image has 8- or 16-bit integers or floats, not {pixels.dtype}")
    return pixels[:, :, : 1 if pixels.shape[2] <= 2 else 3]


def _linear(pixels: np.ndarray, encoded: bool) -> np.ndarray:
    """Values in [0, 1] for integers, with the sRGB curve (IEC 61966-2-1) undone if ``encoded``."""
    if pixels.dtype.kind == "u":
        values = pixels.astype(np.float64) / np.iinfo(pixels.dtype).max
    else:
        values = pixels.astype(np.float64 if encoded else pixels.dtype)
    if not encoded:
        return values
    toe = values / 12.92
    return np.where(values <= 0.04045, toe, ((np.maximum(values, 0.0) + 0.055) / 1.055) ** 2.4)
