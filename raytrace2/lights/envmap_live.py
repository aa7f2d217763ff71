"""How the tables of an environment map follow from pixels, a scale and a rotation that may change.

What is seen has derivatives; how often directions are sampled has none, and is that of the present pixels.
"""

from __future__ import annotations

from math import pi, sin
from typing import Any

import drjit as dr
import numpy as np

from ..live import Live, Place, Slot, Values, derived
from ..scene import description
from ..types import Types, types

_LUMINANCE = (0.212671, 0.715160, 0.072169)
_WIDE = types("float64")


def envmap_slots(table: Any, light: description.EnvironmentLight, live: Live) -> list[Slot]:
    """The slots of ``table`` (:class:`~.envmap.EnvironmentMap`), made of ``light``."""
    found: list[Slot] = []
    # Smaller images are padded in the table.
    if live.has(light, "pixels", "scale") and light.pixels.shape[0] >= 3 and light.pixels.shape[1] >= 2:
        sky = _Sky(light, live, table.types)
        for name, make in (("texels", sky.texels), ("rows", sky.rows), ("columns", sky.columns)):
            found.append(Slot.of(table, name, sky.places, make, moves=False))
        if table.filtered is not None:
            found += derived(table.filtered.slots(), sky.places, sky.twice)
    turned = live.place(light, "to_world")
    if turned is not None:
        found.append(Slot.of(table, "rotation", [turned], lambda base, v: _rotation(base, v(turned)), moves=True))
    return found


class _Sky:
    """The image as it is now: ``height`` rows of ``width`` texels, between which cells of the density lie."""

    def __init__(self, light: description.EnvironmentLight, live: Live, t: Types) -> None:
        self._pixels, self._scale = live.place(light, "pixels"), live.place(light, "scale")
        self.places: list[Place] = [p for p in (self._pixels, self._scale) if p is not None]
        self._types = t
        self.height, self.width = light.pixels.shape[:2]
        self._fixed_scale = light.scale
        self._fixed = t.Float(np.ascontiguousarray(light.pixels, t.numpy).ravel()) + dr.opaque(t.Float, 0)
        sines = np.sin(np.arange(self.height) * (pi / (self.height - 1)))
        # As where nothing is live: a density of 0 at the poles would never find a bright pole beside a dark row.
        sines[[0, -1]] = sin(pi / (4 * (self.height - 1)))
        self._sines = _WIDE.Float(sines) + dr.opaque(_WIDE.Float, 0)
        dr.eval(self._fixed, self._sines)

    def radiance(self, values: Values, columns: int) -> list[Any]:
        """Its channels with ``columns`` texels a row, which go on from the beginning."""
        u, t = self._types.UInt, self._types
        index = dr.arange(u, self.height * columns)
        x, y = index % columns % self.width, index // columns
        # A live image has a column more on either side.
        source = self._fixed if self._pixels is None else values(self._pixels).array
        at = y * self.width + x if self._pixels is None else y * (self.width + 2) + x + 1
        scale = t.Float(self._fixed_scale) if self._scale is None else values(self._scale)
        return [dr.gather(t.Float, source, at * 3 + k) * scale for k in range(3)]

    def texels(self, base: Any, values: Values) -> Any:
        """Records of radiance and density."""
        u = self._types.UInt
        buffer = type(base)(base)
        channels = self.radiance(values, self.width + 1)
        index = dr.arange(u, self.height * (self.width + 1)) * 4
        for k, channel in enumerate((*channels, self._density(values))):
            dr.scatter(buffer, type(base)(channel), index + k)
        return buffer

    def rows(self, base: Any, values: Values) -> Any:
        """The cumulative distribution of the rows of cells."""
        cells = self._cells(self._density(values))
        return self._cumulative(dr.block_sum(cells, self.width), self.height - 1, type(base))

    def columns(self, base: Any, values: Values) -> Any:
        """Those of the cells of each row."""
        return self._cumulative(self._cells(self._density(values)), self.width, type(base))

    def twice(self, values: Values) -> Values:
        """The image and its mirror image beyond the lower pole, as one image."""
        u = self._types.UInt
        channels = self.radiance(values, self.width)
        rows = 2 * self.height - 2
        index = dr.arange(u, rows * self.width)
        x, y = index % self.width, index // self.width
        beyond = y >= self.height
        y = dr.select(beyond, rows - y, y)
        half, odd = self.width // 2, self.width % 2
        # As filtered maps have it: half a turn on, between columns where their number is odd.
        before = [(x + self.width - half - k) % self.width for k in range(2)]
        planes = []
        for channel in channels:
            here, first, second = (dr.gather(type(channel), channel, y * self.width + c) for c in (x, *before))
            planes.append(dr.select(beyond, 0.5 * (first + second) if odd else first, here))
        flat = dr.zeros(type(channels[0]), 3 * rows * self.width)
        for k, plane in enumerate(planes):
            dr.scatter(flat, plane, index * 3 + k)
        image = self._types.TensorXf(flat, (rows, self.width, 3))
        return lambda place: image

    def _density(self, values: Values) -> Any:
        with dr.suspend_grad():
            channels = self.radiance(values, self.width + 1)
            luminance = sum(_WIDE.Float(c) * weight for c, weight in zip(channels, _LUMINANCE, strict=True))
            row = dr.arange(self._types.UInt, self.height * (self.width + 1)) // (self.width + 1)
            density = dr.abs(luminance) * dr.gather(_WIDE.Float, self._sines, row)
            mean = dr.mean(self._cells(density))
            return density / dr.select(mean > 0, mean, 1)

    def _cells(self, density: Any) -> Any:
        u = self._types.UInt
        index = dr.arange(u, (self.height - 1) * self.width)
        first = index // self.width * (self.width + 1) + index % self.width
        corners = (first, first + 1, first + self.width + 1, first + self.width + 2)
        return 0.25 * sum(dr.gather(_WIDE.Float, density, corner) for corner in corners)

    def _cumulative(self, weights: Any, count: int, target: Any) -> Any:
        """Rows of ``count + 1`` numbers from 0 to 1 for rows of ``count`` weights, uniform where all are 0."""
        u = self._types.UInt
        index = dr.arange(u, dr.width(weights))
        row, column = index // count, index % count
        total = dr.gather(_WIDE.Float, dr.block_sum(weights, count), row)
        sums = dr.block_prefix_reduce(dr.ReduceOp.Add, dr.select(total > 0, weights, 1), count, exclusive=False)
        last = dr.gather(_WIDE.Float, sums, row * count + count - 1)
        result = dr.zeros(target, dr.width(weights) // count * (count + 1))
        dr.scatter(result, target(sums / last), row * (count + 1) + column + 1)
        return result


def _rotation(base: tuple[Any, ...], matrix: Any) -> tuple[Any, ...]:
    rows = [_WIDE.Array3f(*(_WIDE.Float(matrix[i, j]) for j in range(3))) for i in range(3)]
    determinant = dr.dot(rows[0], dr.cross(rows[1], rows[2]))
    scale = dr.power(dr.abs(determinant), -1 / 3)
    return tuple(type(b)(*(type(b.x)(c) for c in row * scale)) for b, row in zip(base, rows, strict=True))
