from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from raytrace2 import warp
from raytrace2.types import types

NAMES = [
    "square_to_uniform_disk_concentric", "square_to_cosine_hemisphere", "square_to_uniform_hemisphere",
    "square_to_uniform_sphere", "square_to_uniform_triangle", "square_to_uniform_cone",
]  # fmt: skip
CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1], [0.5, 0.5], [0.5, 0], [0, 0.5], [1 - 2**-24, 0.25]]).T


def call(name: str, sample: object) -> object:
    arguments = (0.3,) if name.endswith("cone") else ()
    return getattr(warp, name)(sample, *arguments)


@pytest.mark.parametrize("name", NAMES)
def test_agrees_with_mitsuba(name: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    sample = np.hstack([np.random.default_rng(0).random((2, 10000)), CORNERS]).astype(np.float32)
    theirs = getattr(mi.warp, name)(mi.Point2f(sample), *((0.3,) if name.endswith("cone") else ()))
    # Near the rim 1 - x^2 - y^2 has lost half its digits; what is compared there is its square.
    ours, theirs = np.array(call(name, types("float32").Array2f(sample))), np.array(theirs)
    if name == "square_to_cosine_hemisphere":
        ours[2], theirs[2] = ours[2] ** 2, theirs[2] ** 2
    assert np.allclose(ours, theirs, atol=1e-6)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", NAMES)
def test_lengths_and_derivatives_at_the_extremes(name: str, precision: str) -> None:
    t = types(precision)
    sample = t.Array2f(CORNERS.astype(t.numpy))
    dr.enable_grad(sample)
    result = call(name, sample)
    length = np.linalg.norm(np.array(dr.detach(result)), axis=0)
    if dr.size_v(type(result)) == 3:
        assert np.allclose(length, 1, atol=1e-3 if precision == "float32" else 1e-7)
    dr.backward(dr.sum(result))
    inside = (CORNERS > 0).all(axis=0) & (CORNERS < 1).all(axis=0)
    assert np.isfinite(np.array(dr.grad(sample))[:, inside]).all()


def test_densities() -> None:
    t = types("float64")
    n = 512
    grid = (np.arange(n) + 0.5) / n
    sample = t.Array2f(*(t.Float(g.ravel()) for g in np.meshgrid(grid, grid)))
    # The mean of cos(theta) under each density, in closed form.
    assert np.mean(np.array(warp.square_to_cosine_hemisphere(sample))[2]) == pytest.approx(2 / 3, abs=1e-4)
    assert np.mean(np.array(warp.square_to_uniform_hemisphere(sample))[2]) == pytest.approx(1 / 2, abs=1e-4)
    assert np.mean(np.array(warp.square_to_uniform_cone(sample, 0.3))[2]) == pytest.approx(0.65, abs=1e-4)
    assert warp.square_to_uniform_cone_pdf(-1.0) == pytest.approx(warp.INV_FOUR_PI)
