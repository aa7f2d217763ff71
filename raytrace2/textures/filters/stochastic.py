"""Filters that read one texel, chosen at random as often as the filter weighs it (Fajardo, Wronski, Salvi and Pharr
2023, "Stochastic Texture Filtering"): right in the mean, at the price of noise."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from ...errors import SettingError
from ...types import types_of
from ..filter_settings import FilterSettings
from .axes import principal_axes, shape, variance, width
from .bicubic import bicubic
from .bicubic import weights as cubic_weights
from .ewa import each_texel, ellipse_of, ewa, mixture, texel_at
from .point import bilinear, nearest
from .probes import probe_line, probes
from .trilinear import split_level, trilinear, trilinear_shorter

# Of each of two random numbers so many values choose the place in a pixel, and the rest of it chooses the texel.
_PLACES = 4096


def stochastic(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    """One texel of those that the filter ``settings.of`` reads, chosen by ``footprint.random``.

    The mean over random numbers is what the filter gives. ``bicubic`` has negative weights: it reads two texels, one of
    each sign, so that a constant stays what it is. ``exact`` and ``exact2`` look up the bilinear texture at a place of
    the pixel. ``SettingError`` where no random numbers are given.

    Derivatives are those of the filter itself, as a choice has none; of ``exact`` and ``exact2`` those of the bilinear
    texture at the place that was chosen, whose mean they are.
    """
    if footprint.random is None:
        raise SettingError(f"stochastic texture filters need random numbers, which {settings.of!r} itself does without")
    choice = _CHOICES[settings.of]
    if not dr.grad_enabled(uv, footprint, bitmaps.buffers):
        return choice(bitmaps, image, uv, footprint, settings, active)
    with dr.suspend_grad():
        chosen = choice(bitmaps, image, uv, footprint, settings, active)
    return dr.replace_grad(chosen, _MEANS[settings.of](bitmaps, image, uv, footprint, settings, active))


def _nearest(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    return nearest(bitmaps, image, uv, active=active)


def _bilinear(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    return _one_of_four(bitmaps, image, uv, footprint.random.x, footprint.random.y, active)


def _one_of_four(bitmaps: Any, image: Any, uv: Any, r: Any, s: Any, active: Any) -> Any:
    x, y = dr.fma(uv.x, image.width, -0.5), dr.fma(uv.y, image.height, -0.5)
    left, top = dr.floor(x), dr.floor(y)
    columns, rows = bitmaps.columns(image, left), bitmaps.rows(image, top)
    column, row = dr.select(r < x - left, columns[1], columns[0]), dr.select(s < y - top, rows[1], rows[0])
    return bitmaps.texel(image, column, row, active)


def _bicubic(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    x, y = dr.fma(uv.x, image.width, -0.5), dr.fma(uv.y, image.height, -0.5)
    left, top = dr.floor(x), dr.floor(y)
    columns = (*bitmaps.columns(image, left - 1), *bitmaps.columns(image, left + 1))
    rows = (*bitmaps.rows(image, top - 1), *bitmaps.rows(image, top + 1))
    wx, wy = cubic_weights(x - left), cubic_weights(y - top)
    # Along an axis the two texels within have positive weights, the two without negative ones; in the plane the
    # weight is positive where both axes agree.
    minus_x, minus_y = -(wx[0] + wx[3]), -(wy[0] + wy[3])
    outer = minus_x * minus_y
    inner = (1 + minus_x) * (1 + minus_y)
    values = []
    for first, second, flipped in ((inner, outer, False), ((1 + minus_x) * minus_y, minus_x * (1 + minus_y), True)):
        both = first + second
        share = dr.select(both > 0, first / dr.select(both > 0, both, 1), 1)
        chosen, r = _choose(footprint.random.x, share)
        column = _of_sign(columns, wx, r, chosen)
        row = _of_sign(rows, wy, footprint.random.y, chosen ^ flipped)
        values.append(bitmaps.texel(image, column, row, active))
    negative = (1 + minus_x) * minus_y + minus_x * (1 + minus_y)
    return dr.fma(negative, values[0] - values[1], values[0])


def _of_sign(places: Any, weights: Any, r: Any, inside: Any) -> Any:
    """Of the four ``places`` one of the inner two, or of the outer two, as often as their weights say."""
    total = dr.select(inside, weights[1] + weights[2], weights[0] + weights[3])
    last = r * total
    within = dr.select(dr.abs(last) < dr.abs(weights[2]), places[2], places[1])
    without = dr.select(dr.abs(last) < dr.abs(weights[3]), places[3], places[0])
    return dr.select(inside, within, without)


def _trilinear(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    texels = width(settings.pixel, principal_axes(footprint).major)
    return _one_of_eight(bitmaps, image, uv, texels, footprint.random.x, footprint.random.y, active)


def _trilinear_shorter(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    texels = width(settings.pixel, principal_axes(footprint).minor)
    return _one_of_eight(bitmaps, image, uv, texels, footprint.random.x, footprint.random.y, active)


def _one_of_eight(bitmaps: Any, image: Any, uv: Any, texels: Any, r: Any, s: Any, active: Any) -> Any:
    level, fraction = split_level(bitmaps, texels)
    coarse, r = _choose(r, fraction)
    return _one_of_four(bitmaps, bitmaps.level(image, dr.select(coarse, level + 1, level), active), uv, r, s, active)


def _probes(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    line = probe_line(bitmaps, image, footprint, settings)
    r, s = footprint.random.x, footprint.random.y
    if line.shape == "box":
        place = r * line.count
        k = dr.fmin(dr.floor(place), line.count - 1)
        r = place - k
    else:

        def step(k: Any, chosen: Any, weights: Any, r: Any) -> tuple[Any, ...]:
            weight = line.weight(k)
            weights += weight
            here, r = _choose(r, weight / dr.fmax(weights, 1e-30))
            return k + 1, dr.select(here, k, chosen), weights, r

        zero = dr.zeros(type(r), dr.width(line.count, r))
        state = dr.while_loop(
            (zero, zero, zero, r + zero), lambda k, *_: active & (k < line.count), step, labels=("k", "at", "w", "r")
        )
        k, r = state[1], state[3]
    return _one_of_eight(bitmaps, image, uv + line.place(k) * line.step, line.texels, r, s, active)


def _ewa(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    major, ellipse = ellipse_of(bitmaps, image, uv, footprint, settings, active)
    wide, s = _choose(footprint.random.y, mixture(major))
    zero = dr.zeros(type(major), dr.width(major, uv, s))

    def visit(i: Any, j: Any, weight: Any, state: tuple[Any, ...]) -> tuple[Any, ...]:
        column, row, weights, r = state
        weights += weight
        chosen, r = _choose(r, weight / dr.select(weights > 0, weights, 1))
        return dr.select(chosen, i, column), dr.select(chosen, j, row), weights, r

    i, j, _, _ = each_texel(ellipse, active & wide, (zero, zero, zero, footprint.random.x + zero), visit)
    texel = bitmaps.texel(ellipse.image, *texel_at(bitmaps, ellipse, i, j), active & wide)
    return dr.select(wide, texel, _one_of_four(bitmaps, image, uv, footprint.random.x, s, active & ~wide))


def _exact(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    at, r, s = _affine_place(image, uv, footprint, settings)
    return _one_of_four(bitmaps, image, at, r, s, active)


def _exact_mean(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    return bilinear(bitmaps, image, _affine_place(image, uv, footprint, settings)[0], active=active)


def _affine_place(image: Any, uv: Any, footprint: Any, settings: FilterSettings) -> tuple[Any, Any, Any]:
    x, y, r, s = _place_in_pixel(footprint.random, settings)
    return _moved(image, uv, x * footprint.dx + y * footprint.dy), r, s


def _exact2(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    at, r, s = _curved_place(image, uv, footprint, settings)
    return _one_of_four(bitmaps, image, at, r, s, active)


def _exact2_mean(bitmaps: Any, image: Any, uv: Any, footprint: Any, settings: FilterSettings, active: Any) -> Any:
    return bilinear(bitmaps, image, _curved_place(image, uv, footprint, settings)[0], active=active)


def _curved_place(image: Any, uv: Any, footprint: Any, settings: FilterSettings) -> tuple[Any, Any, Any]:
    x, y, r, s = _place_in_pixel(footprint.random, settings)
    offset = x * footprint.dx + y * footprint.dy
    if footprint.dxx is not None:
        offset += 0.5 * x * x * footprint.dxx + x * y * footprint.dxy + 0.5 * y * y * footprint.dyy
    return _moved(image, uv, offset), r, s


def _moved(image: Any, uv: Any, texels: Any) -> Any:
    return type(uv)(uv.x + texels.x / image.width, uv.y + texels.y / image.height)


def _place_in_pixel(random: Any, settings: FilterSettings) -> tuple[Any, Any, Any, Any]:
    """A place (x, y) in pixels from the centre, as often as the pixel filter weighs it, and what remains random."""
    result = []
    for r in (random.x, random.y):
        cell = dr.floor(r * _PLACES)
        t = (cell + 0.5) * (1 / _PLACES)
        spread = math.sqrt(variance(settings.pixel))
        kind = shape(settings.pixel)
        if kind == "gaussian":
            place = spread * math.sqrt(2) * dr.erfinv(2 * t - 1)
        elif kind == "tent":
            less = dr.sqrt(2 * dr.fmin(t, 1 - t)) - 1
            place = spread * math.sqrt(6) * dr.select(t < 0.5, less, -less)
        else:
            place = t - 0.5
        result.append((place, dr.fma(r, _PLACES, -cell)))
    (x, r), (y, s) = result
    return x, y, r, s


def _choose(r: Any, probability: Any) -> tuple[Any, Any]:
    """Whether ``r``, random in [0, 1), is below ``probability``, and ``r`` stretched to be random again."""
    chosen = r < probability
    largest = 1 - 2 * types_of(r).epsilon
    rest = dr.select(chosen, r, r - probability) / dr.select(chosen, probability, 1 - probability)
    return chosen, dr.fmin(rest, largest)


_CHOICES = {
    "nearest": _nearest,
    "bilinear": _bilinear,
    "bicubic": _bicubic,
    "mip_distance": _trilinear,
    "trilinear": _trilinear,
    "trilinear_shorter": _trilinear_shorter,
    "probes": _probes,
    "ewa": _ewa,
    "exact": _exact,
    "exact2": _exact2,
}

# What the choices are in the mean.
_MEANS = {
    "nearest": nearest,
    "bilinear": bilinear,
    "bicubic": bicubic,
    "mip_distance": trilinear,
    "trilinear": trilinear,
    "trilinear_shorter": trilinear_shorter,
    "probes": probes,
    "ewa": ewa,
    "exact": _exact_mean,
    "exact2": _exact2_mean,
}
