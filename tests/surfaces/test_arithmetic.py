"""What the exact tests of primitives take for granted of Dr.Jit and LLVM: each operation written is one, rounded once.

An update that contracts ``a * b - c * d`` into a fused multiply-add, or splits ``dr.fma`` in two, breaks the signs of
edge functions without any other test saying why.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction

import drjit as dr
import numpy as np
import pytest

from raytrace2.surfaces.ordered import greater, lesser
from raytrace2.types import types

PRECISIONS = ("float32", "float64")
LANES = 500


def nearest(x: Fraction, precision: str) -> Fraction:
    """The number of ``precision`` next to ``x``, of two as near the even one; for numbers of benign size."""
    if x == 0:
        return x
    digits = 24 if precision == "float32" else 53
    exponent = abs(x.numerator).bit_length() - x.denominator.bit_length()
    while abs(x) >= Fraction(2) ** (exponent + 1):
        exponent += 1
    while abs(x) < Fraction(2) ** exponent:
        exponent -= 1
    unit = Fraction(2) ** (exponent - digits + 1)
    return round(x / unit) * unit


def operands(precision: str) -> list[np.ndarray]:
    """a, b, c, d (LANES,) with products that are close to one another, so that what is rounded off is all there is."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(1, 2, (2, LANES)) * 2.0 ** rng.integers(-8, 9, LANES) * rng.choice([-1, 1], (2, LANES))
    kind = np.dtype(types(precision).numpy).type
    a, b = a.astype(kind), b.astype(kind)
    c = (a.astype(np.float64) * rng.choice([0.5, 1, 1, 1.0001], LANES)).astype(kind)
    d = np.nextafter(b, kind(0), dtype=kind)
    return [a, b, c, d]


def plainly(function: Callable, arrays: list) -> object:
    return function(*arrays)


def in_a_loop(function: Callable, arrays: list) -> object:
    """As the last turn of a symbolic loop, in a branch."""
    UInt = dr.uint32_array_t(type(arrays[0]))

    def turn(i, x):
        (x,) = dr.if_stmt((x,), i == 2, lambda x: (function(*arrays),), lambda x: (x + 1,))
        return i + 1, x

    start = (dr.zeros(UInt, LANES), dr.zeros(type(arrays[0]), LANES))
    return dr.while_loop(start, lambda i, x: i < 3, turn)[1]


EXPRESSIONS: dict[str, tuple[Callable, Callable[..., Fraction], Callable[..., Fraction]]] = {
    # What is written, what it shall give, and what it would if contracted or split.
    "a * b - c * d": (
        lambda a, b, c, d: a * b - c * d,
        lambda r, a, b, c, d: r(r(a * b) - r(c * d)),
        lambda r, a, b, c, d: r(a * b - r(c * d)),
    ),
    "a * b + c": (
        lambda a, b, c, d: a * b + c,
        lambda r, a, b, c, d: r(r(a * b) + c),
        lambda r, a, b, c, d: r(a * b + c),
    ),
    "c - a * b": (
        lambda a, b, c, d: c - a * b,
        lambda r, a, b, c, d: r(c - r(a * b)),
        lambda r, a, b, c, d: r(c - a * b),
    ),
    "fma(a, b, c)": (
        lambda a, b, c, d: dr.fma(a, b, c),
        lambda r, a, b, c, d: r(a * b + c),
        lambda r, a, b, c, d: r(r(a * b) + c),
    ),
    "fma(a, b, -c * d)": (
        lambda a, b, c, d: dr.fma(a, b, -(c * d)),
        lambda r, a, b, c, d: r(a * b - r(c * d)),
        lambda r, a, b, c, d: r(r(a * b) - r(c * d)),
    ),
    "fma(-a, b, a * b)": (
        lambda a, b, c, d: dr.fma(-a, b, a * b),
        lambda r, a, b, c, d: r(r(a * b) - a * b),
        lambda r, a, b, c, d: Fraction(0),
    ),
    # What two-sums live by: no term may be cancelled as in real arithmetic.
    "a + b - a - b": (
        lambda a, b, c, d: ((a + b) - a) - b,
        lambda r, a, b, c, d: r(r(r(a + b) - a) - b),
        lambda r, a, b, c, d: Fraction(0),
    ),
    "a / b * b - a": (
        lambda a, b, c, d: (a / b) * b - a,
        lambda r, a, b, c, d: r(r(r(a / b) * b) - a),
        lambda r, a, b, c, d: Fraction(0),
    ),
}


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("where", [plainly, in_a_loop])
@pytest.mark.parametrize("name", EXPRESSIONS)
def test_every_operation_rounds_once(name: str, where: Callable, precision: str) -> None:
    function, wanted, otherwise = EXPRESSIONS[name]
    host = operands(precision)
    Float = types(precision).Float
    found = where(function, [Float(x) for x in host]).numpy()
    rows = [[Fraction(float(x)) for x in row] for row in zip(*host, strict=True)]

    def rounded(x: Fraction) -> Fraction:
        return nearest(x, precision)

    exact = [wanted(rounded, *row) for row in rows]
    assert [Fraction(float(x)) for x in found] == exact
    # The operands tell one from the other.
    assert sum(a != otherwise(rounded, *row) for a, row in zip(exact, rows, strict=True)) > LANES // 20


@pytest.mark.parametrize("precision", PRECISIONS)
def test_vectors_round_as_their_components_do(precision: str) -> None:
    t, (a, b, c, d) = types(precision), operands(precision)
    u, v, x, y = (t.Array3f(t.Float(k), t.Float(k), t.Float(k)) for k in (a, b, c, d))
    unfused, fused = (u * v - x * y).numpy(), dr.fma(u, v, -(x * y)).numpy()
    np.testing.assert_array_equal(unfused, np.tile(a * b - c * d, (3, 1)))
    assert (unfused != fused).any()


@pytest.mark.parametrize("precision", PRECISIONS)
def test_lesser_and_greater_give_the_second_for_nan(precision: str) -> None:
    Float, nan = types(precision).Float, np.nan
    a, b = Float([1, 2, nan, 3, nan]), Float([2, 1, 3, nan, nan])
    np.testing.assert_array_equal(lesser(a, b), [1, 1, 3, nan, nan])
    np.testing.assert_array_equal(greater(a, b), [2, 2, 3, nan, nan])


def test_minima_and_maxima_compile() -> None:
    """In a process of its own: an LLVM that cannot select them aborts."""
    code = """
import raytrace2, drjit as dr
from raytrace2.types import types
for precision in ("float32", "float64"):
    Float = types(precision).Float
    a, b = Float([1, 2, -3]), Float([2, 1, -4])
    dr.make_opaque(a, b)
    for low, high in ((dr.minimum, dr.maximum), (dr.fmin, dr.fmax)):
        assert dr.all((low(a, b) == Float([1, 1, -4])) & (high(a, b) == Float([2, 2, -3])))
    assert dr.all(dr.clip(a, b - 1.5, b + 0.5) == Float([1, 1.5, -3.5]))
print("done")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "done"
