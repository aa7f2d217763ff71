"""Minimum and maximum as one machine instruction, with a stated answer for NaN.

``dr.fmin`` and ``dr.fmax`` need three instructions each on x86, to return the number when one argument is NaN;
written as a comparison and a selection, LLVM finds the single instruction.
"""

from __future__ import annotations

from typing import Any

import drjit as dr


def lesser(a: Any, b: Any) -> Any:
    """The smaller of ``a`` and ``b``; ``b`` if either is NaN."""
    return dr.select(a < b, a, b)


def greater(a: Any, b: Any) -> Any:
    """The larger of ``a`` and ``b``; ``b`` if either is NaN."""
    return dr.select(a > b, a, b)
