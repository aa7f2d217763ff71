"""The Dr.Jit array types of one floating-point precision, as one namespace.

Tracing code never names ``drjit.llvm.ad`` types: it takes them from :func:`types` or, given an array, from
:func:`types_of`, so that the same code runs in float32 and in float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import drjit.llvm.ad as ad

Precision = Literal["float32", "float64"]


@dataclass(frozen=True)
class Types:
    """Dr.Jit types whose floating-point members share one precision.

    ``epsilon`` is the unit round-off (half the distance from 1 to the next number) and ``largest`` the largest
    finite number.
    """

    precision: Precision
    Float: Any
    Array2f: Any
    Array3f: Any
    Array4f: Any
    ArrayXf: Any
    Matrix3f: Any
    Matrix4f: Any
    TensorXf: Any
    numpy: str
    epsilon: float
    largest: float
    UInt: Any = ad.UInt32
    Int: Any = ad.Int32
    UInt64: Any = ad.UInt64
    Bool: Any = ad.Bool
    Array2u: Any = ad.Array2u
    Array3u: Any = ad.Array3u
    Array4u: Any = ad.Array4u
    Array2i: Any = ad.Array2i
    PCG32: Any = ad.PCG32


_FLOAT32 = Types(
    "float32",
    ad.Float32,
    ad.Array2f,
    ad.Array3f,
    ad.Array4f,
    ad.ArrayXf,
    ad.Matrix3f,
    ad.Matrix4f,
    ad.TensorXf,
    "float32",
    2.0**-24,
    3.4028234663852886e38,
)
_FLOAT64 = Types(
    "float64",
    ad.Float64,
    ad.Array2f64,
    ad.Array3f64,
    ad.Array4f64,
    ad.ArrayXf64,
    ad.Matrix3f64,
    ad.Matrix4f64,
    ad.TensorXf64,
    "float64",
    2.0**-53,
    1.7976931348623157e308,
)


def types(precision: str) -> Types:
    """The types of ``precision``, which is ``"float32"`` or ``"float64"``; ``ValueError`` for anything else."""
    if precision == "float32":
        return _FLOAT32
    if precision == "float64":
        return _FLOAT64
    raise ValueError(f"precision must be 'float32' or 'float64', not {precision!r}")


def types_of(array: Any) -> Types:
    """The types whose floating-point arrays ``array`` (a Float, Array2f, Array3f, ...) belongs to."""
    import drjit as dr

    return _FLOAT64 if dr.type_v(array) == dr.VarType.Float64 else _FLOAT32
