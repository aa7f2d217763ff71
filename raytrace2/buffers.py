"""NumPy data in buffers that Dr.Jit owns."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np


def owned(array: np.ndarray, dtype: Any) -> Any:
    """A Dr.Jit 1D array of type ``dtype`` that holds a copy of ``array``, flattened.

    Dr.Jit wraps NumPy memory without a copy where it can, and memory that is not aligned to its liking falls back from
    packet gathers to single ones, several times slower. The copy is always aligned.
    """
    source = dtype(np.ascontiguousarray(array).ravel())
    if len(source) == 0:
        return dr.zeros(dtype, 1)
    target = dr.empty(dtype, len(source))
    dr.scatter(target, source, dr.arange(dr.uint32_array_t(dtype), len(source)))
    dr.eval(target)
    return target
