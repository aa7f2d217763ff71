"""Decoding of sRGB and the luminance of linear Rec. 709 colours."""

from __future__ import annotations

from typing import Any

import drjit as dr

# A rational approximation of ((x + 0.055) / 1.055)^2.4 at x = 11/255 ... 255/255, fitted to relative error: 3.1e-8 at
# worst, below float32's round-off, at a tenth of the cost of a power function.
_NUMERATOR = (
    0.0008339930986256315, 0.042529080368269676, 0.7414221492118405,
    4.918001932037656, 10.471640888293473, 4.859973756378206,
)  # fmt: skip
_DENOMINATOR = (1.0, 7.389417579191034, 10.623111992395424, 2.108137250317956, -0.08626566922747758)


def srgb_byte_to_linear(byte: Any, float_type: Any) -> Any:
    """Linear intensity (a ``float_type``) of an 8-bit sRGB value (an integer array); IEC 61966-2-1.

    Relative error below 3e-7 in float32, that of the power function in float64.
    """
    x = float_type(byte) * (1.0 / 255.0)
    if dr.type_v(float_type) == dr.VarType.Float64:
        curve = dr.power((x + 0.055) / 1.055, 2.4)
    else:
        curve = _polynomial(_NUMERATOR, x) / _polynomial(_DENOMINATOR, x)
    return dr.select(byte <= 10, x * (1.0 / 12.92), curve)


def luminance(rgb: Any) -> Any:
    """Luminance of a linear colour (Array3f), with the weights that Mitsuba uses."""
    return rgb.x * 0.212671 + rgb.y * 0.715160 + rgb.z * 0.072169


def _polynomial(coefficients: tuple[float, ...], x: Any) -> Any:
    result = type(x)(coefficients[-1])
    for c in coefficients[-2::-1]:
        result = dr.fma(result, x, c)
    return result
