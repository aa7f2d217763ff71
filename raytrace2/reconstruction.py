"""Reconstruction filters: how much a sample counts for a pixel whose centre lies some way off.

The functions are Mitsuba's, value for value, so that images of equal samples agree; none of them is normalised, because
the film divides by the sum of the weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from .errors import Problem, SceneError
from .scene.description import ReconstructionFilter
from .types import types_of

# The polynomial of degree 9 in t whose *relative* error to exp(-t/2) is least on [0, 16] (4.04e-4; Remez exchange in
# extended precision). Mitsuba evaluates its Gaussian so on CPUs: an exact exponential would differ by that much.
_EXPONENTIAL = (
    0.9995958150079868, -0.4977025246961059, 0.12222485500390623, -0.019324062818058475, 0.002136713060829853,
    -0.00016798738600289168, 9.202145247696906e-06, -3.329417433098852e-07, 7.128382793651252e-09,
    -6.821193280488147e-11,
)  # fmt: skip


@dataclass(frozen=True)
class Filter:
    """A separable filter. ``radius`` is in pixels; ``eval(x)`` maps a Float of signed distances in pixels to weights.

    ``taps`` is how many pixels on either side of the sample's own can be reached; ``is_box`` says that a sample counts
    for its own pixel alone, with weight 1.
    """

    name: str
    radius: float
    eval: Callable[[Any], Any]

    @property
    def is_box(self) -> bool:
        # Mitsuba takes *every* filter of this radius for the box, so a file that asks for one means that.
        return self.radius == 0.5

    @property
    def taps(self) -> int:
        return 0 if self.is_box else max(0, math.ceil(self.radius - 0.5))

    @property
    def border(self) -> int:
        """Pixels by which ``sample_border`` enlarges the sampled region on each side."""
        return 0 if self.is_box else max(0, math.ceil(self.radius - 0.5 - 2e-4))


def make_filter(desc: ReconstructionFilter) -> Filter:
    """The filter that ``desc`` describes; :class:`SceneError` for parameters that make no filter."""
    name = desc.name
    if name == "box":
        if desc.radius not in (None, 0.5):
            raise _error(
                f"a box filter has radius 0.5, not {desc.radius!r}", "use a tent or gaussian filter to blur more"
            )
        return Filter(name, 0.5, _box)
    if name == "tent":
        radius = _positive("radius of a tent filter", 1.0 if desc.radius is None else desc.radius)
        return Filter(name, radius, lambda x: dr.fmax(0, 1 - dr.abs(x * (1 / radius))))
    if name == "gaussian":
        stddev = _positive("stddev of a gaussian filter", desc.stddev)
        return Filter(name, 4 * stddev, _gaussian(stddev))
    if name == "mitchell":
        return Filter(name, 2.0, _cubic(_finite("B", desc.B), _finite("C", desc.C)))
    if name == "catmullrom":
        return Filter(name, 2.0, _cubic(0.0, 0.5))
    if name == "lanczos":
        lobes = _positive("lobes of a lanczos filter", desc.lobes)
        return Filter(name, float(lobes), _lanczos(float(lobes)))
    raise _error(f"unknown reconstruction filter {name!r}", "use box, tent, gaussian, mitchell, catmullrom or lanczos")


def _box(x: Any) -> Any:
    return dr.select((x >= -0.5) & (x < 0.5), type(x)(1), 0)


def _gaussian(stddev: float) -> Callable[[Any], Any]:
    # Less its value at the radius, found with the roundings that evaluation makes, which would leave a pedestal.
    coefficients: dict[str, list[float]] = {}
    for precision in (np.float32, np.float64):
        deviation = float(precision(stddev))
        rounded = [precision(c / deviation ** (2 * i)) for i, c in enumerate(_EXPONENTIAL)]
        edge = _estrin(precision(4 * deviation) ** 2, rounded, _fma)
        coefficients[precision.__name__] = [float(rounded[0] - edge), *(float(c) for c in rounded[1:])]
    return lambda x: dr.fmax(_estrin(dr.square(x), coefficients[types_of(x).precision], dr.fma), 0)


def _fma(a: Any, b: Any, c: Any) -> Any:
    """``a * b + c`` rounded once, for scalars of single precision; double precision does not need it."""
    return type(a)(np.float64(a) * np.float64(b) + np.float64(c))


def _estrin(x: Any, coefficients: Sequence[Any], fma: Callable[[Any, Any, Any], Any]) -> Any:
    """A polynomial by Estrin's scheme. Its terms cancel, so the order of the operations shows in single precision."""
    while len(coefficients) > 1:
        odd = coefficients[len(coefficients) & ~1 :]
        pairs = zip(coefficients[::2], coefficients[1::2], strict=False)
        coefficients = [fma(x, high, low) for low, high in pairs] + list(odd)
        x = x * x
    return coefficients[0]


def _cubic(b: float, c: float) -> Callable[[Any], Any]:
    """The piecewise cubics of Mitchell and Netravali (1988, SIGGRAPH); B = 0, C = 1/2 is Catmull and Rom's."""
    a3, a2, a0 = 12 - 9 * b - 6 * c, -18 + 12 * b + 6 * c, 6 - 2 * b
    b3, b2, b1, b0 = -b - 6 * c, 6 * b + 30 * c, -12 * b - 48 * c, 8 * b + 24 * c

    def evaluate(x: Any) -> Any:
        x = dr.abs(x)
        x2 = dr.square(x)
        x3 = x2 * x
        near = dr.fma(a3, x3, dr.fma(a2, x2, a0))
        far = dr.fma(b3, x3, dr.fma(b2, x2, dr.fma(b1, x, b0)))
        return dr.select(x < 2, dr.select(x < 1, near, far) * (1 / 6), 0)

    return evaluate


def _lanczos(lobes: float) -> Callable[[Any], Any]:
    """The sinc function windowed by its own main lobe, stretched to ``lobes`` (Duchon 1979)."""

    def evaluate(x: Any) -> Any:
        x = dr.abs(x)
        x1 = x * math.pi
        x2 = x1 / lobes
        value = dr.sin(x1) * dr.sin(x2) / dr.select(x == 0, 1, x1 * x2)
        return dr.select(x < 1e-6, 1, dr.select(x > lobes, 0, value))

    return evaluate


def _positive(what: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise _error(f"the {what} must be a positive number, not {value!r}", "correct the rfilter")
    return value


def _finite(what: str, value: float) -> float:
    if not math.isfinite(value):
        raise _error(f"{what} of a mitchell filter must be a number, not {value!r}", "correct the rfilter")
    return value


def _error(message: str, remedy: str) -> SceneError:
    return SceneError([Problem(message, remedy=remedy)])
