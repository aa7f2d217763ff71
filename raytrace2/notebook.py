"""Images that show themselves in a notebook."""

from __future__ import annotations

import io
import sys
from typing import Any

import numpy as np


def show_images_in_notebooks() -> None:
    """Teaches a running IPython to show Dr.Jit tensors that look like images, as :func:`render` returns them;
    elsewhere does nothing."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if shell is None:
        return
    import drjit.llvm.ad as ad

    formatter = shell.display_formatter.formatters["image/png"]
    for kind in (ad.TensorXf, ad.TensorXf64):
        formatter.for_type(kind, image_png)


def image_png(image: Any) -> bytes | None:
    """The PNG of a (height, width, 1, 3 or more) tensor, its first channels as sRGB; None for other shapes."""
    if len(image.shape) != 3 or 0 in image.shape or image.shape[2] == 2:
        return None
    from PIL import Image

    from .image_io import linear_to_srgb

    pixels = np.array(image)[..., : 3 if image.shape[2] >= 3 else 1]
    pixels = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels
    encoded = np.clip(linear_to_srgb(np.nan_to_num(pixels)), 0, 1)
    stream = io.BytesIO()
    Image.fromarray((encoded * 255 + 0.5).astype(np.uint8)).save(stream, format="PNG")
    return stream.getvalue()
