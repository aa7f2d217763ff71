"""Which pixels and samples the lanes of one pass stand for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..types import types


@dataclass(frozen=True)
class Wavefront:
    """``samples`` consecutive samples of each of ``pixels`` consecutive pixels: the samples of one pixel lie together.

    Pixels are numbered along rows from the top left of the film's sampled region. A whole image in one pass, in
    Mitsuba's order, is ``Wavefront(pixel_count, samples_per_pixel)``. ``ValueError`` for a pass
    that is empty or past 2^32 lanes.
    """

    pixels: int
    samples: int
    first_pixel: int = 0
    first_sample: int = 0

    def __post_init__(self) -> None:
        if self.pixels < 1 or self.samples < 1 or self.first_pixel < 0 or self.first_sample < 0:
            raise ValueError(f"a pass needs at least one pixel and one sample: {self}")
        if self.size >= 2**32 or self.first_pixel + self.pixels > 2**32 or self.first_sample + self.samples > 2**32:
            raise ValueError(f"a pass cannot have 2^32 lanes or more (use split_passes): {self}")

    @property
    def size(self) -> int:
        """The number of lanes."""
        return self.pixels * self.samples

    def pixel_and_sample(self) -> tuple[Any, Any]:
        """Two UInt, one entry a lane: the pixel and the number of the sample within it."""
        UInt = types("float32").UInt
        lane = dr.arange(UInt, self.size)
        if self.samples & (self.samples - 1):
            pixel = lane // dr.opaque(UInt, self.samples)
        else:
            pixel = lane >> dr.opaque(UInt, self.samples.bit_length() - 1)
        sample = lane - pixel * dr.opaque(UInt, self.samples)
        return pixel + dr.opaque(UInt, self.first_pixel), sample + dr.opaque(UInt, self.first_sample)


def split_passes(pixels: int, samples: int, max_lanes: int) -> list[Wavefront]:
    """Passes of at most ``max_lanes`` lanes that together cover ``samples`` samples of every one of ``pixels`` pixels.

    Passes cover the whole image while that fits, so that what is done at any time is an image; they differ in size as
    little as possible.
    """
    if max_lanes < 1:
        raise ValueError(f"a pass needs at least one lane, not {max_lanes}")
    per_pass = max(1, min(samples, max_lanes // pixels))
    return [
        Wavefront(pixel_count, sample_count, first_pixel, first_sample)
        for first_sample, sample_count in _even_parts(samples, per_pass)
        for first_pixel, pixel_count in _even_parts(pixels, max_lanes)
    ]


def _even_parts(total: int, largest: int) -> list[tuple[int, int]]:
    """(start, length) of the fewest parts of ``total``, none above ``largest``, whose lengths differ by at most one."""
    count = -(-total // largest)
    bounds = [total * i // count for i in range(count + 1)]
    return [(low, high - low) for low, high in zip(bounds, bounds[1:], strict=False)]
