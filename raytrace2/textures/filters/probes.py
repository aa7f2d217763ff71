"""Several trilinear look-ups along a footprint's longer axis (EXT_texture_filter_anisotropic; Direct3D 11)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr

from ...types import types_of
from ..filter_settings import FilterSettings
from ..replayed import summed
from .axes import anisotropy, principal_axes, shape, width
from .trilinear import between_levels

# A Gaussian counts this far, in standard deviations.
_REACH = 2.5


@dataclass
class Line:
    """Probes ``0 <= k < count`` (Floats): at ``uv + (k - (count - 1) / 2) * step``, ``texels`` wide each."""

    count: Any
    step: Any
    texels: Any
    #: The standard deviation of the probes' places, in steps.
    deviation: Any
    shape: str

    def place(self, k: Any) -> Any:
        """How many steps from the middle probe ``k`` is."""
        return k - 0.5 * (self.count - 1)

    def weight(self, k: Any) -> Any:
        """What probe ``k`` counts, as the pixel filter has it; 1 for the middle."""
        if self.shape == "gaussian":
            return dr.exp2(-0.5 / math.log(2) * dr.square(self.place(k) / dr.fmax(self.deviation, 1e-3)))
        if self.shape == "tent":
            return dr.fmax(1 - dr.abs(self.place(k)) / _half_width(self.deviation), 0)
        return type(k)(1)


def probes(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    """As many probes as the longer axis holds shorter ones, ``max_anisotropy`` at most, their mean weighted by the
    pixel filter; each is a trilinear look-up of the longer axis over that number.

    Shorter axes below a texel count as a texel. No bound on the anisotropy means as many probes as the largest image
    of the table has texels a side. For Gaussians there are up to 1.45 times as many and two more, for tents 1.42 times
    as many.
    """
    line = probe_line(bitmaps, image, footprint, settings)
    zero = dr.zeros(type(line.count), dr.width(uv.x, line.count))

    def probe(k: Any, uv: Any, step: Any, texels: Any) -> Any:
        return between_levels(bitmaps, image, uv + line.place(k) * step, texels, active)

    def more(k: Any, *_: Any) -> Any:
        return active & (k < line.count)

    def step(k: Any, first: Any, weights: Any, total: Any) -> tuple[Any, Any, Any, Any]:
        value = probe(k, uv, line.step, line.texels)
        # Differences to the first one: equal probes give what they are, whatever the weights round to.
        first = dr.select(k == 0, value, first)
        weight = line.weight(k)
        return k + 1, first, weights + weight, dr.fma(weight, value - first, total)

    def terms(inputs: Any, k: Any, first: Any, _: Any) -> tuple[Any]:
        # At the first probe there is no first one yet; whichever constant it is, derivatives are the same.
        return (line.weight(k) * (probe(k, *inputs) - first),)

    value = zero if bitmaps.channels == 1 else dr.zeros(types_of(zero).Array3f, dr.width(zero))
    inputs = uv, line.step, line.texels
    _, first, weights, total = summed(
        (zero, value, zero), (value,), more, step, terms, inputs, bitmaps.buffers, "probes of a footprint"
    )
    return first + total / dr.select(weights > 0, weights, 1)


def probe_line(bitmaps: Any, image: Any, footprint: Any, settings: FilterSettings) -> Line:
    """Where the probes of ``footprint`` lie."""
    axes = principal_axes(footprint)
    major, minor = width(settings.pixel, axes.major), width(settings.pixel, axes.minor)
    boxes = dr.clip(dr.ceil(major / dr.fmax(minor, 1)), 1, math.ceil(anisotropy(bitmaps, settings)))
    guess = footprint.is_guess()
    if guess is not None:
        boxes = dr.select(guess, 1, boxes)
    texels = major / boxes
    several = boxes > 1
    # The places have the variance that the pixel filter has along the axis, which n places a box apart fall short of.
    deviation = dr.select(several, boxes * math.sqrt(1 / 12), 0)
    kind = shape(settings.pixel)
    count, spread = boxes, texels
    if kind == "gaussian":
        count = 1 + dr.ceil(2 * _REACH * deviation)
    elif kind == "tent":
        # Less a little: where the width is a whole number, round-off shall not decide whether there is one more.
        count = dr.ceil(2 * _half_width(deviation) - 1e-3) - 1
    else:
        spread = texels * dr.select(several, boxes * dr.rsqrt(dr.fmax(boxes * boxes - 1, 1)), 1)
    step = axes.direction * spread
    step = type(step)(step.x / image.width, step.y / image.height)
    return Line(count, step, texels, deviation, kind)


def _half_width(deviation: Any) -> Any:
    """Where a tent ends whose values at the integers have this standard deviation."""
    return dr.sqrt(dr.fma(6 * deviation, deviation, 1))
