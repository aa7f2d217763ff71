"""Rays: wavefront batches in structure-of-arrays form."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from ..arguments import real_array
from ..types import Types, types


class Ray:
    """A batch of rays ``o + t d`` for ``tmin <= t <= tmax``; ``d`` need not be of unit length.

    ``o`` and ``d`` may be NumPy arrays of shape (n, 3) (or (3,)), Dr.Jit Array3f, or Mitsuba points and vectors;
    ``tmin`` and ``tmax`` are numbers or arrays of n. A Mitsuba ``Ray3f`` may be given alone as ``o``. The precision
    is ``precision`` if given, else that of a Dr.Jit ``o``, else float32. ``ValueError`` tells of shapes that do not
    fit.
    """

    DRJIT_STRUCT = {"o": Any, "d": Any, "tmin": Any, "tmax": Any}

    def __init__(
        self, o: Any = None, d: Any = None, tmin: Any = 0.0, tmax: Any = float("inf"), *, precision: str | None = None
    ) -> None:
        if o is None:  # Dr.Jit makes empty ones when it takes a PyTree apart
            return
        if d is None:
            if not (hasattr(o, "o") and hasattr(o, "d")):
                raise ValueError("Ray needs an origin and a direction: Ray(o, d)")
            source = o
            o, d = source.o, source.d
            if hasattr(source, "maxt"):
                tmax = source.maxt
            if hasattr(source, "tmax"):
                tmin, tmax = source.tmin, source.tmax
        if precision is None:
            precision = "float64" if _is_jit(o) and dr.type_v(o) == dr.VarType.Float64 else "float32"
        t = types(precision)
        with np.errstate(over="ignore"):
            self._take(o, d, tmin, tmax, t)

    def _take(self, o: Any, d: Any, tmin: Any, tmax: Any, t: Types) -> None:
        self.o = _vectors(o, t, "o")
        self.d = _vectors(d, t, "d")
        self.tmin = _scalars(tmin, t, "tmin")
        self.tmax = _scalars(tmax, t, "tmax")
        empty = [name for name in ("o", "d", "tmin", "tmax") if dr.width(getattr(self, name)) == 0]
        if empty:
            raise ValueError(f"{empty[0]} holds no ray; a batch needs at least one")
        widths = {dr.width(x) for x in (self.o, self.d, self.tmin, self.tmax)} - {1}
        if len(widths) > 1:
            raise ValueError(f"o, d, tmin and tmax hold different numbers of rays: {sorted(widths)}")

    @staticmethod
    def of(o: Any, d: Any, tmin: Any = 0.0, tmax: Any = float("inf")) -> Ray:
        """A ray of Dr.Jit arrays of one precision, taken as they are: for kernels, where nothing is left to check."""
        ray = Ray()
        Float = type(d.x)
        ray.o, ray.d, ray.tmin, ray.tmax = o, d, Float(tmin), Float(tmax)
        return ray

    def __call__(self, t: Any) -> Any:
        """The points at parameter ``t``."""
        return dr.fma(self.d, t, self.o)

    def __len__(self) -> int:
        return max(dr.width(self.o), dr.width(self.d), dr.width(self.tmax))


def _is_jit(value: Any) -> bool:
    return value is not None and bool(dr.is_jit_v(value))


def _vectors(value: Any, t: Types, name: str) -> Any:
    if _is_jit(value) and not dr.is_tensor_v(value):
        if dr.depth_v(value) != 2 or len(value) != 3:
            raise ValueError(f"{name} must be an Array3f or of shape (n, 3), not a {type(value).__name__}")
        return t.Array3f(value)
    array = real_array(value, name, ValueError).astype(t.numpy)
    if array.ndim not in (1, 2) or array.shape[-1] != 3:
        raise ValueError(f"{name} must have shape (n, 3), not {array.shape}")
    return t.Array3f(np.ascontiguousarray(array.reshape(-1, 3).T))


def _scalars(value: Any, t: Types, name: str) -> Any:
    if _is_jit(value) and not dr.is_tensor_v(value):
        if dr.depth_v(value) != 1:
            raise ValueError(f"{name} must be a number or a Float, not a {type(value).__name__}")
        return t.Float(value)
    array = real_array(value, name, ValueError).astype(t.numpy)
    if array.ndim > 1:
        raise ValueError(f"{name} must be a number or of shape (n,), not {array.shape}")
    return t.Float(array.ravel()) if array.ndim else t.Float(float(value))
