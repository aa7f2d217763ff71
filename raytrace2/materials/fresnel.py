"""Fresnel's equations for unpolarised light at a smooth interface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr


@dataclass
class Interface:
    """What :func:`fresnel_dielectric` finds (Floats).

    ``reflectance``; ``cos_theta_t``, the cosine between the normal and the refracted ray, on the other side than ``wi``
    (0 under total reflection); ``eta``, the index of refraction beyond the interface over that on the side of ``wi``;
    ``inverse_eta``.
    """

    reflectance: Any
    cos_theta_t: Any
    eta: Any
    inverse_eta: Any


def fresnel_dielectric(cos_theta_i: Any, eta: Any) -> Interface:
    """Reflection between dielectrics; ``eta`` > 0 is the index behind the surface over that in front of it.

    Rays may come from either side (sign of ``cos_theta_i``). Grazing rays and rays beyond the critical angle are wholly
    reflected, and nothing is reflected where ``eta`` is 1. (Born and Wolf, Principles of Optics, section 1.5.)
    """
    outside = cos_theta_i >= 0
    inverse = 1 / eta
    ahead = dr.select(outside, eta, inverse)
    behind = dr.select(outside, inverse, eta)
    cos_i = dr.abs(cos_theta_i)
    sin2_i = dr.fma(-cos_i, cos_i, 1)
    cos2_t = dr.fma(-sin2_i, behind * behind, 1)
    total = cos2_t <= 0
    cos_t = dr.safe_sqrt(cos2_t)
    s = _quotient(dr.fma(-ahead, cos_t, cos_i), dr.fma(ahead, cos_t, cos_i), total)
    p = _quotient(dr.fma(-ahead, cos_i, cos_t), dr.fma(ahead, cos_i, cos_t), total)
    # Grazing and index-matched at once looks like total reflection, but there is no interface: matching wins.
    reflectance = dr.select(eta == 1, 0, dr.select(total, 1, 0.5 * (s * s + p * p)))
    return Interface(reflectance, dr.select(outside, -cos_t, cos_t), ahead, behind)


def fresnel_conductor(cos_theta_i: Any, eta: Any, k: Any) -> Any:
    """Reflectance of a conductor whose relative complex index of refraction is ``eta + i k``, for ``cos_theta_i`` > 0.

    ``eta`` and ``k`` are Array3f (or Float), and so is the result. (Born and Wolf, section 14.2; K. D. Moeller,
    Optics, 1988.)
    """
    cos2 = cos_theta_i * cos_theta_i
    sin2 = 1 - cos2
    difference = eta * eta - k * k - sin2
    modulus = dr.safe_sqrt(difference * difference + 4 * (eta * eta) * (k * k))
    a = dr.safe_sqrt(0.5 * (modulus + difference))
    twice = 2 * cos_theta_i * a
    denominator = modulus + cos2 + twice
    s = _quotient(modulus + cos2 - twice, denominator, denominator == 0)
    denominator = modulus * cos2 + sin2 * sin2 + twice * sin2
    p = s * _quotient(modulus * cos2 + sin2 * sin2 - twice * sin2, denominator, denominator == 0)
    return 0.5 * (s + p)


def _quotient(numerator: Any, denominator: Any, apart: Any) -> Any:
    # Where ``apart``, the quotient is not used; its derivative must stay finite even so.
    return numerator / dr.select(apart, 1, denominator)
