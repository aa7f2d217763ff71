"""How uv changes from pixel to pixel, from rays through neighbouring pixels."""

from __future__ import annotations

from typing import Any

import drjit as dr


def uv_partials(si: Any, ray: Any, offset_ray: Any) -> Any:
    """The difference in uv (Array2f) between where ``ray`` met ``si`` and where ``offset_ray`` meets its tangent plane.

    Least squares in the basis of ``dp_du`` and ``dp_dv`` (Pharr, Jakob and Humphreys 2023, section 10.1.1); zero where
    the offset ray is parallel to the plane or the parameterisation is singular.
    """
    slope = dr.dot(si.n, offset_ray.d)
    meets = slope != 0
    # From the difference of the rays: the two points on the plane share their leading digits, which would cancel.
    apart = dr.fma(offset_ray.d - ray.d, si.t, offset_ray.o - ray.o)
    offset = dr.fma(offset_ray.d, -dr.dot(si.n, apart) / dr.select(meets, slope, 1), apart)
    a00, a01, a11 = dr.dot(si.dp_du, si.dp_du), dr.dot(si.dp_du, si.dp_dv), dr.dot(si.dp_dv, si.dp_dv)
    determinant = a00 * a11 - a01 * a01
    regular = meets & (determinant > 0)
    inverse = dr.rcp(dr.select(regular, determinant, 1))
    b0, b1 = dr.dot(si.dp_du, offset), dr.dot(si.dp_dv, offset)
    result = type(si.uv)((a11 * b0 - a01 * b1) * inverse, (a00 * b1 - a01 * b0) * inverse)
    return dr.select(regular & dr.isfinite(result.x) & dr.isfinite(result.y), result, 0)
