from __future__ import annotations

import math

import drjit as dr
import numpy as np
import pytest

from raytrace2.errors import SceneError
from raytrace2.reconstruction import _EXPONENTIAL, make_filter
from raytrace2.scene.description import ReconstructionFilter
from raytrace2.types import types

mi = pytest.importorskip("mitsuba")
if mi.variant() is None:
    mi.set_variant("llvm_ad_rgb")

FILTERS = [
    ReconstructionFilter("box"),
    ReconstructionFilter("tent"),
    ReconstructionFilter("tent", radius=2.3),
    ReconstructionFilter("gaussian"),
    ReconstructionFilter("gaussian", stddev=0.8),
    ReconstructionFilter("mitchell"),
    ReconstructionFilter("mitchell", B=0.1, C=0.7),
    ReconstructionFilter("catmullrom"),
    ReconstructionFilter("lanczos"),
    ReconstructionFilter("lanczos", lobes=2),
]


def mitsuba_settings(desc):
    settings = {"type": desc.name}
    if desc.name == "tent" and desc.radius is not None:
        settings["radius"] = desc.radius
    for name, field in (("gaussian", "stddev"), ("mitchell", "B"), ("mitchell", "C"), ("lanczos", "lobes")):
        if desc.name == name:
            settings[field] = getattr(desc, field)
    return settings


@pytest.mark.parametrize("desc", FILTERS, ids=str)
def test_values_radius_and_border_are_those_of_mitsuba(desc):
    ours, theirs = make_filter(desc), mi.load_dict(mitsuba_settings(desc))
    assert ours.radius == pytest.approx(theirs.radius(), rel=1e-7)
    assert ours.border == theirs.border_size()
    assert ours.is_box == theirs.is_box_filter()
    r = ours.radius
    x = np.concatenate([np.linspace(-r, r, 20001), [0.0, 1.0, -1.0, 0.5, -0.5]])
    reference = np.array(theirs.eval(mi.Float(x)))
    assert np.abs(np.array(ours.eval(types("float32").Float(x))) - reference).max() <= 6e-6
    # The terms of the Gaussian's polynomial reach 170 and cancel: single precision leaves such an error.
    assert np.abs(np.array(ours.eval(types("float64").Float(x))) - reference).max() <= 3e-5


@pytest.mark.parametrize("desc", FILTERS, ids=str)
def test_filters_end_at_their_radius(desc):
    ours = make_filter(desc)
    for precision, bound in (("float32", 3e-6), ("float64", 1e-15)):
        assert np.abs(np.array(ours.eval(types(precision).Float([ours.radius]))))[0] < bound
    assert ours.taps >= ours.radius - 0.5


def test_the_exponential_is_the_best_of_its_degree():
    t = np.linspace(0, 16, 400001)
    error = np.polyval(_EXPONENTIAL[::-1], t) * np.exp(t / 2) - 1
    worst = np.abs(error).max()
    # Chebyshev: least when the extreme error is met with alternating signs at degree + 2 points.
    signs = np.sign(error)
    pieces = np.split(error, np.flatnonzero(signs[1:] != signs[:-1]) + 1)
    assert len(pieces) == len(_EXPONENTIAL) + 1
    assert all(np.abs(piece).max() > 0.9999 * worst for piece in pieces)
    assert worst < 4.05e-4


def test_derivatives_are_finite_everywhere():
    t = types("float64")
    for desc in FILTERS:
        filter = make_filter(desc)
        x = t.Float([0.0, 1e-9, 0.5, 1.0, filter.radius])
        dr.enable_grad(x)
        dr.backward(filter.eval(x) + x)
        assert np.isfinite(np.array(dr.grad(x))).all(), desc


@pytest.mark.parametrize(
    "desc",
    [
        ReconstructionFilter("box", radius=1.0),
        ReconstructionFilter("tent", radius=0.0),
        ReconstructionFilter("tent", radius=math.nan),
        ReconstructionFilter("gaussian", stddev=-1.0),
        ReconstructionFilter("lanczos", lobes=0),
        ReconstructionFilter("mitchell", B=math.inf),
        ReconstructionFilter("sinc"),  # type: ignore[arg-type]
    ],
)
def test_filters_that_cannot_be_are_refused(desc):
    with pytest.raises(SceneError):
        make_filter(desc)
