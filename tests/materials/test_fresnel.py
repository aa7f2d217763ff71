from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from raytrace2.materials.fresnel import fresnel_conductor, fresnel_dielectric
from raytrace2.types import types


def exact(cos_i: np.ndarray, index: complex | np.ndarray) -> np.ndarray:
    """Fresnel's equations in complex arithmetic, from the side that the ray is on."""
    cos_t = np.sqrt(1 - (1 - cos_i**2) / np.asarray(index, dtype=complex) ** 2)
    s = (cos_i - index * cos_t) / (cos_i + index * cos_t)
    p = (index * cos_i - cos_t) / (index * cos_i + cos_t)
    return 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("eta", [1.5, 1 / 1.5, 1.0001, 1.33, 4.0])
def test_dielectric_reflectance(precision: str, eta: float) -> None:
    t = types(precision)
    cosines = np.linspace(-1, 1, 2002)
    f = fresnel_dielectric(t.Float(cosines), t.Float(eta))
    expected = exact(np.abs(cosines), np.where(cosines >= 0, eta, 1 / eta))
    critical = np.abs(np.array(f.cos_theta_t)) < 0.02
    tolerance = 1e-4 if precision == "float32" else 1e-11
    assert np.allclose(f.reflectance, expected, atol=np.where(critical, 100 * tolerance, tolerance))
    assert (np.array(f.cos_theta_t) * cosines <= 0).all()


@settings(max_examples=150, deadline=None)
@given(st.floats(-1, 1, width=32), st.floats(2.0**-10, 2.0**10, width=32))
def test_dielectric_at_the_extremes(cos_i: float, eta: float) -> None:
    t = types("float32")
    c, index = dr.opaque(t.Float, cos_i), dr.opaque(t.Float, eta)
    dr.enable_grad(c)
    f = fresnel_dielectric(c, index)
    dr.backward(f.reflectance + f.cos_theta_t)
    r = f.reflectance[0]
    assert 0 <= r <= 1.000001
    assert np.isfinite(dr.grad(c)[0])
    if cos_i == 0 and eta != 1:
        assert r == 1
    if eta == 1:
        assert r == 0


def test_index_matched_and_critical_angle() -> None:
    t = types("float32")
    assert (np.array(fresnel_dielectric(t.Float([1, 0.5, 0, -0.5]), t.Float(1)).reflectance) == 0).all()
    below = np.sqrt(1 - (1 / 1.5) ** 2)
    beyond = fresnel_dielectric(t.Float([-below + 1e-3, -1e-6]), t.Float(1.5))
    assert (np.array(beyond.reflectance) == pytest.approx(1)) and (np.array(beyond.cos_theta_t) == 0).all()
    nearly = fresnel_dielectric(t.Float(1), t.Float(1 + 2.0**-20))
    assert 0 <= nearly.reflectance[0] < 1e-11


@pytest.mark.parametrize(("eta", "k"), [(0.2, 3.9), (1.1, 2.6), (2.9, 3.0), (0.0, 1.0), (1.5, 0.0)])
def test_conductor_reflectance(eta: float, k: float) -> None:
    for precision, tolerance in (("float32", 1e-5), ("float64", 1e-9)):
        t = types(precision)
        cosines = np.linspace(0.001, 1, 500)
        r = np.array(fresnel_conductor(t.Float(cosines), t.Float(eta), t.Float(k)))
        assert np.allclose(r, exact(cosines, complex(eta, k)), atol=tolerance)
