"""Pixels as linear numbers."""

from __future__ import annotations

import numpy as np

from .description import BitmapTexture


def linear_pixels(texture: BitmapTexture) -> np.ndarray:
    """The pixels as linear float32 numbers (float64 if they are that)."""
    pixels = texture.pixels
    if pixels.dtype != np.uint8:
        return pixels if pixels.dtype == np.float64 else pixels.astype(np.float32)
    x = pixels.astype(np.float64) / 255
    if not texture.raw:
        x = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return x.astype(np.float32)
