"""What texel coordinates mean beyond an image's edges.

Coordinates stay floating-point numbers with integer values: floating-point arithmetic wraps them without an integer
division, and any of them, be it huge, infinite or NaN, ends inside the image.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import drjit as dr

REPEAT, MIRROR, CLAMP = 0, 1, 2
MODES = {"repeat": REPEAT, "mirror": MIRROR, "clamp": CLAMP}


def wrap(x: Any, size: Any, mode: Any, modes: Collection[int]) -> tuple[Any, Any]:
    """Where the texels ``x`` and ``x + 1`` of a line of ``size`` lie: two Floats with integer values in [0, size).

    ``x`` is an integer-valued Float; ``modes`` holds the wrap modes that occur, and ``mode`` (UInt) tells which one
    where they are several.
    """
    result = None
    for candidate in sorted(modes):
        pair = _PAIRS[candidate](x, size)
        if result is None:
            result = pair
        else:
            chosen = mode == candidate
            result = dr.select(chosen, pair[0], result[0]), dr.select(chosen, pair[1], result[1])
    assert result is not None
    return _inside(result[0], size), _inside(result[1], size)


def _repeat(x: Any, size: Any) -> tuple[Any, Any]:
    x = _modulo(x, size)
    return x, _next(x, size)


def _mirror(x: Any, size: Any) -> tuple[Any, Any]:
    period = size + size
    x = _modulo(x, period)
    after = _next(x, period)
    return dr.select(x < size, x, period - 1 - x), dr.select(after < size, after, period - 1 - after)


def _clamp(x: Any, size: Any) -> tuple[Any, Any]:
    return x, x + 1


def _modulo(x: Any, n: Any) -> Any:
    # The quotient may be one off by rounding; the fused remainder is exact and says so.
    r = dr.fma(-n, dr.floor(x / n), x)
    r = dr.select(r < 0, r + n, r)
    return dr.select(r >= n, r - n, r)


def _next(x: Any, n: Any) -> Any:
    after = x + 1
    return dr.select(after >= n, 0, after)


def _inside(x: Any, size: Any) -> Any:
    # Order matters: the number wins over a NaN in either, so what comes out can be an index.
    return dr.fmin(dr.fmax(x, 0), size - 1)


_PAIRS = {REPEAT: _repeat, MIRROR: _mirror, CLAMP: _clamp}
