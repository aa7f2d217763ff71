"""NumPy data in buffers that Dr.Jit owns."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np

from .errors import SettingError
from .types import Types

_ALIGNMENT = 64


def owned(array: np.ndarray, dtype: Any) -> Any:
    """A Dr.Jit 1D array of type ``dtype`` that holds a copy of ``array``, flattened.

    Dr.Jit wraps NumPy memory without a copy where it can, and memory that is not aligned to its liking falls back from
    packet gathers to single ones, several times slower. The copy is always aligned. :class:`~raytrace2.SettingError` in
    a function that Dr.Jit is freezing, where NumPy's memory cannot be given back: Dr.Jit would end the process.
    """
    if dr.flag(dr.JitFlag.FreezingScope):
        raise SettingError("NumPy arrays cannot be used in a function that is being frozen: make them arguments of it")
    source = dtype(_aligned(array))
    if len(source) == 0:
        return dr.zeros(dtype, 1)
    target = dr.empty(dtype, len(source))
    dr.scatter(target, source, dr.arange(dr.uint32_array_t(dtype), len(source)))
    dr.eval(target)
    return target


def apart(value: Any) -> Any:
    """``value``, any Dr.Jit array of floats, with its derivatives, in memory of its own once it is evaluated.

    Dr.Jit shares the memory of tensors of other frameworks and of NumPy, into which these write: optimisers do.
    """
    if dr.is_tensor_v(value):
        return type(value)(apart(value.array), value.shape)
    if dr.depth_v(value) > 1:
        rows = [apart(part) for part in value]
        # Iteration over a matrix gives its rows, of which it cannot be made with derivatives.
        return type(value)(*([x for row in rows for x in row] if dr.is_matrix_v(value) else rows))
    if value.state != dr.VarState.Evaluated:
        return value
    # Bits that a kernel reads and writes, for it knows of no copy: several times quicker than to scatter.
    Bits = dr.uint_array_t(type(value))
    bits = dr.reinterpret_array(Bits, dr.detach(value)) ^ dr.opaque(Bits, 0)
    return dr.replace_grad(dr.reinterpret_array(type(value), bits), value)


def aligned_zeros(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """NumPy zeros that Dr.Jit can gather packets from where they lie."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.zeros(size + _ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % _ALIGNMENT
    return memory[start : start + size].view(dtype).reshape(shape)


def _aligned(array: Any) -> np.ndarray:
    """``array``, flattened, or a copy: kernels that read NumPy's memory are others where it is not aligned, which it is
    or is not by chance."""
    flat = np.ascontiguousarray(array).ravel()
    if flat.ctypes.data % _ALIGNMENT == 0:
        return flat
    copy = aligned_zeros(flat.shape, flat.dtype)
    copy[:] = flat
    return copy


def owned_rows(table: np.ndarray, order: np.ndarray, types: Types) -> Any:
    """What ``owned(table[order], types.Float)`` is, on all cores; the indices ``order`` must lie within the table."""
    Float, UInt = types.Float, types.UInt
    n, columns = len(order), table.shape[1]
    if n == 0:
        return dr.zeros(Float, 1)
    source, index = Float(_aligned(table)), UInt(_aligned(order.astype(np.uint32)))
    target = dr.empty(Float, n * columns)
    packet = dr.gather(types.ArrayXf, source, index, shape=(columns, n))
    dr.scatter(target, packet, dr.arange(UInt, n))
    dr.eval(target)
    return target
