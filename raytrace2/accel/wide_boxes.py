"""Rays against the quantised child boxes of wide nodes.

Boxes are widened by :data:`ERROR` times the distance to them, which bounds the rounding of the slab test (Ize 2013),
of the primitive tests and of the clamped direction, so that no hit is culled that a test would have found. Nodes that
are not ``padded`` go without: a box that a ray passes by rounding of its planes may then be missed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import drjit.llvm.ad as ad

from ..surfaces.ordered import greater, lesser
from ..surfaces.primitives import LocalRay
from ..types import Types
from .wide_node import CORNER, EXPONENTS, NodeFormat, NodeLayout

#: In units of the round-off, what the rounding of a slab test, a primitive test and the clamping of a direction add up
#: to, relative to the sum over the axes of the distances to the box's far planes (each contributes fewer than ten
#: units).
ERROR = 32


@dataclass
class Slabs:
    """What the slab test needs of a ray: origin, reciprocal direction and its size, and whether each component is
    negative."""

    o: Any
    inverse: Any
    size: Any
    negative: list[Any]
    tmin: Any


@dataclass(frozen=True, eq=False)
class QuantisedNodes:
    """Nodes in the ``words`` of :mod:`.wide_node`."""

    types: Types
    layout: NodeLayout
    words: Any
    padded: bool = True

    @property
    def width(self) -> int:
        """The most children of a node."""
        return self.layout.width

    @property
    def bytes(self) -> int:
        """On the device."""
        return dr.width(self.words) * NodeFormat.of(self.types).word.itemsize

    def prepare(self, ray: LocalRay) -> Slabs:
        """What the tests need, once per ray."""
        d = ray.d
        size = abs(d)
        # A component this much smaller than the largest moves the ray by less than the boxes are widened; the clamp
        # keeps reciprocals finite, so that no product with zero is NaN.
        least = dr.fmax(dr.fmax(size.x, size.y), size.z) * self.types.epsilon
        clamped = type(d)(*(dr.select(s < least, dr.copysign(least, c), c) for s, c in zip(size, d, strict=True)))
        inverse = dr.rcp(clamped)
        return Slabs(ray.o, inverse, abs(inverse), [c < 0 for c in clamped], ray.tmin)

    def visit(self, at: Any, slabs: Slabs, tmax: Any) -> tuple[list[tuple[Any, Any]], list[Any]]:
        """For each child of node ``at`` where a ray enters its box and whether it does; and the references to the
        children."""
        words = self._load(at)
        near, far = self._planes(words, slabs)
        met = []
        for child in range(self.width):
            enter = greater(greater(near(0, child), near(1, child)), greater(near(2, child), slabs.tmin))
            leave = lesser(lesser(far(0, child), far(1, child)), lesser(far(2, child), tmax))
            met.append((enter, enter <= leave))
        return met, [_low_word(words[self.layout.children + k]) for k in range(self.width)]

    def octant(self, slabs: Slabs) -> Any:
        """UInt: a bit for each negative component of the direction."""
        UInt = self.types.UInt
        bits = [dr.select(negative, UInt(1 << k), UInt(0)) for k, negative in enumerate(slabs.negative)]
        return bits[0] | bits[1] | bits[2]

    def child(self, node: Any, slot: Any, active: Any) -> Any:
        """The reference to child ``slot`` of ``node``."""
        Word = self.types.UInt if self.types.precision == "float32" else self.types.UInt64
        return _low_word(dr.gather(Word, self.words, (node * self.layout.words) + self.layout.children + slot, active))

    def _load(self, at: Any) -> list[Any]:
        """The node's words, as unsigned integers of the precision's width."""
        kind = ad.ArrayXu if self.types.precision == "float32" else ad.ArrayXu64
        packet = dr.gather(kind, self.words, at, shape=(self.layout.words, dr.width(at)))
        return [packet[k] for k in range(self.layout.words)]

    def _planes(self, words: list[Any], slabs: Slabs) -> tuple[Any, Any]:
        """Functions of (axis, child) that give the t of the plane where a ray enters and leaves the child's slab.

        With the byte q put into a float as 1 + q / 256, its plane is corner + 256 step (float - 1), so t is one
        multiply-add.
        """
        form, layout = NodeFormat.of(self.types), self.layout
        Float = self.types.Float
        Word = type(words[0])
        exponent_mask = Word(((1 << form.exponent_bits) - 1) << form.mantissa)
        offsets = [dr.reinterpret_array(Float, words[CORNER + k]) - slabs.o[k] for k in range(3)]
        scales = []
        for k in range(3):
            shift = form.mantissa - k * form.exponent_bits
            shifted = words[EXPONENTS] << shift if shift >= 0 else words[EXPONENTS] >> -shift
            scales.append(dr.reinterpret_array(Float, shifted & exponent_mask))
        error = None
        if self.padded:
            reach = abs(offsets[0]) + abs(offsets[1]) + abs(offsets[2]) + (scales[0] + scales[1] + scales[2])
            error = reach * (ERROR * self.types.epsilon)
        slopes, near_bases, far_bases, near_words, far_words = [], [], [], [], []
        for k in range(3):
            slope = scales[k] * slabs.inverse[k]
            base = dr.fma(offsets[k], slabs.inverse[k], -slope)
            slopes.append(slope)
            near_bases.append(base if error is None else dr.fma(-error, slabs.size[k], base))
            far_bases.append(base if error is None else dr.fma(error, slabs.size[k], base))
            for part in range(layout.per_axis):
                place = k * layout.per_axis + part
                lower, upper = words[layout.lower + place], words[layout.upper + place]
                near_words.append(dr.select(slabs.negative[k], upper, lower))
                far_words.append(dr.select(slabs.negative[k], lower, upper))
        byte_mask = Word(0xFF << (form.mantissa - 8))
        one = Word(form.bias << form.mantissa)

        def decoded(planes: list[Any], axis: int, child: int) -> Any:
            word = planes[axis * layout.per_axis + child // 4]
            shift = form.mantissa - 8 - 8 * (child % 4)
            moved = word << shift if shift >= 0 else word >> -shift
            return dr.reinterpret_array(Float, (moved & byte_mask) | one)

        def near(axis: int, child: int) -> Any:
            return dr.fma(decoded(near_words, axis, child), slopes[axis], near_bases[axis])

        def far(axis: int, child: int) -> Any:
            return dr.fma(decoded(far_words, axis, child), slopes[axis], far_bases[axis])

        return near, far


def _low_word(word: Any) -> Any:
    return dr.uint32_array_t(type(word))(word)
