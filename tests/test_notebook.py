"""Images show themselves where there is a notebook, and only what looks like an image does."""

from __future__ import annotations

import io
import types

import drjit.llvm.ad as ad
import numpy as np
import pytest
from PIL import Image

from raytrace2.notebook import image_png, show_images_in_notebooks


def decoded(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)))


def test_colours_are_encoded_as_srgb() -> None:
    pixels = np.zeros((2, 3, 3), np.float32)
    pixels[0, 1] = [1.0, 0.5, np.nan]
    png = image_png(ad.TensorXf(pixels))
    assert png is not None
    assert decoded(png).shape == (2, 3, 3)
    assert decoded(png)[0, 1].tolist() == [255, 188, 0]


def test_one_channel_is_grey_and_aovs_show_their_colour() -> None:
    grey = image_png(ad.TensorXf64(np.full((2, 2, 1), 1.0)))
    assert grey is not None and (decoded(grey) == 255).all()
    many = image_png(ad.TensorXf(np.zeros((2, 2, 7), np.float32)))
    assert many is not None and decoded(many).shape == (2, 2, 3)


@pytest.mark.parametrize("shape", [(4,), (2, 2), (2, 2, 2), (0, 2, 3)])
def test_other_tensors_show_as_before(shape: tuple[int, ...]) -> None:
    assert image_png(ad.TensorXf(np.zeros(shape, np.float32))) is None


def test_a_running_notebook_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    told: dict[type, object] = {}
    png = types.SimpleNamespace(for_type=told.__setitem__)
    shell = types.SimpleNamespace(display_formatter=types.SimpleNamespace(formatters={"image/png": png}))
    monkeypatch.setitem(__import__("sys").modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
    show_images_in_notebooks()
    assert told == {ad.TensorXf: image_png, ad.TensorXf64: image_png}
