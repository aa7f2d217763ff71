"""The film: samples of any pass, filtered into an image."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from .errors import Problem, SceneError
from .packets import load_packets, store_packets
from .rays.wavefront import Wavefront
from .reconstruction import make_filter
from .scene.description import Film as FilmDescription
from .types import Types
from .types import types as make_types

# CIE 1931 luminance, and all of XYZ, of linear Rec. 709 primaries with a D65 white point.
_LUMINANCE = (0.212671, 0.715160, 0.072169)
_XYZ = ((0.412453, 0.357580, 0.180423), _LUMINANCE, (0.019334, 0.119193, 0.950227))


class Film:
    """Sums of filtered samples and of their weights over the crop window, kept from pass to pass in float64.

    ``channels`` is the number of values a sample brings. Pixels are numbered along rows from the top left of the
    *sampled region*: the crop window, enlarged by the filter's border where ``sample_border`` asks for that;
    ``pixel_count`` is their number. Samples that are not finite are left out of the image and counted: see
    :meth:`non_finite_samples`.
    """

    def __init__(self, desc: FilmDescription, types: Types, channels: int) -> None:
        _check(desc, channels)
        self.filter = make_filter(desc.rfilter)
        self.types = types
        self.channels = channels
        self.width, self.height = desc.crop_width, desc.crop_height
        self.pixel_format = desc.pixel_format
        self.border = self.filter.border if desc.sample_border else 0
        self.sampled_width, self.sampled_height = self.width + 2 * self.border, self.height + 2 * self.border
        self.pixel_count = self.sampled_width * self.sampled_height
        if self.width * self.height * (channels + 1) >= 2**32 or self.pixel_count >= 2**32:
            raise _error(
                f"a film of {self.width} x {self.height} x {channels} is too large", "render it in crop windows"
            )
        self._sum_types = make_types("float64")
        self._sum_type: Any = self._sum_types.Float
        # Sizes are read from memory, so that kernels are reused from film to film.
        self._columns, self._rows = dr.opaque(types.Int, self.width), dr.opaque(types.Int, self.height)
        self._sampled_columns = dr.opaque(types.UInt, self.sampled_width)
        self._sampled_rows = dr.opaque(types.UInt, self.sampled_height)
        self._scale_x, self._scale_y = dr.opaque(types.Float, 1 / self.width), dr.opaque(types.Float, 1 / self.height)
        self.clear()

    def clear(self) -> None:
        """Forget all samples."""
        self._sums = dr.zeros(self._sum_type, self.width * self.height * (self.channels + 1))
        self._bad = dr.zeros(self.types.UInt, self.pixel_count)

    def position(self, pixel: Any, offset: Any) -> Any:
        """What cameras take (Array2f, [0, 1]^2 over the crop window) for places within pixels.

        ``pixel`` is a UInt below ``pixel_count``; ``offset`` an Array2f in [0, 1)^2 from the pixel's top left corner.
        """
        x, y = self._crop_pixel(pixel)
        t = self.types
        return t.Array2f((t.Float(x) + offset.x) * self._scale_x, (t.Float(y) + offset.y) * self._scale_y)

    def add(self, where: Any, offset: Any, values: list[Any], active: Any = True) -> None:
        """Add one sample a lane. Evaluates the sums, unless ``values`` carry derivatives.

        ``where`` is the :class:`Wavefront` of the pass, or, for lanes in any other order, a UInt of pixels, where
        those that are not below ``pixel_count`` count for nothing. With a wavefront the sums do not vary from run to
        run; with pixels they may, in their last bits. ``offset`` (Array2f) is the place of each sample in its pixel,
        ``values`` one Float a channel. ``ValueError`` for a wavefront, or values, that this film has no room for.
        """
        if len(values) != self.channels:
            raise ValueError(f"this film has {self.channels} channels, not {len(values)}")
        t = self.types
        if isinstance(where, Wavefront):
            if where.first_pixel + where.pixels > self.pixel_count:
                raise ValueError(f"this film has {self.pixel_count} pixels: too few for {where}")
            pixel = where.pixel_and_sample()[0]
        else:
            pixel = t.UInt(where)
            active = (pixel < dr.opaque(t.UInt, self.pixel_count)) & active
        values = [t.Float(value) for value in values]
        finite = t.Bool(True)
        for value in values:
            finite &= dr.isfinite(value)
        # Straight to memory: a copy per thread would put the film's size into the kernel.
        dr.scatter_add(self._bad, t.UInt(1), pixel, ~finite & active, mode=dr.ReduceMode.Direct)
        active = finite & active
        values = [dr.select(active, value, 0) for value in (*values, t.Float(1))]
        if not dr.grad_enabled(values):
            # One kernel computes what the filter reads; left to the stores below, each would trace its paths again.
            dr.eval(values, offset, self._bad)
        if dr.grad_enabled(values) or not isinstance(where, Wavefront):
            self._splat(pixel, offset, values, active)
        elif self.filter.is_box:
            self._sum_blocks(where, values)
        else:
            self._gather(where, offset, values)
        if not dr.grad_enabled(self._sums):
            dr.eval(self._sums, self._bad)

    def add_to_sums(self, pixel: Any, offset: Any, values: list[Any], active: Any) -> None:
        """Adds ``values`` to what samples at ``offset`` in ``pixel`` add to, without counting them as samples. Sums may
        vary from run to run in their last bits."""
        self._splat(pixel, offset, [*values, self.types.Float(0)], active)
        dr.eval(self._sums)

    def pixel_at(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """The inverse of :meth:`position`: the pixel, the offset in it, and whether samples are taken there (Bool), for
        film positions ``x``, ``y`` (Floats)."""
        t = self.types
        x, y = x * t.Float(self._columns) + self.border, y * t.Float(self._rows) + self.border
        inside = (x >= 0) & (y >= 0) & (x < t.Float(self._sampled_columns)) & (y < t.Float(self._sampled_rows))
        x, y = dr.select(inside, x, 0), dr.select(inside, y, 0)
        column, row = dr.floor(x), dr.floor(y)
        return t.UInt(row) * self._sampled_columns + t.UInt(column), t.Array2f(x - column, y - row), inside

    def develop(self) -> Any:
        """The image so far, TensorXf (height, width, channels): filtered values over weights, 0 where no sample fell.

        With the pixel formats luminance and xyz the first three channels are converted (three become one, or three).
        """
        t = self.types
        stride = self.channels + 1
        start = dr.arange(t.UInt, self.width * self.height) * stride
        weight = dr.gather(self._sum_type, self._sums, start + self.channels)
        weight = dr.select(weight == 0, 1, weight)
        values = [dr.gather(self._sum_type, self._sums, start + i) / weight for i in range(self.channels)]
        values = _convert(self.pixel_format, values)
        image = dr.empty(t.Float, self.width * self.height * len(values))
        target = dr.arange(t.UInt, self.width * self.height) * len(values)
        for i, value in enumerate(values):
            dr.scatter(image, t.Float(value), target + i)
        return t.TensorXf(image, (self.height, self.width, len(values)))

    def expect(self, samples: int) -> None:
        """Lets every pixel weigh as much as ``samples`` samples of a box filter do, without their values."""
        index = dr.arange(self.types.UInt, self.width * self.height) * (self.channels + 1) + self.channels
        dr.scatter(self._sums, self._sum_type(dr.opaque(self.types.Float, samples)), index)

    def adjoint(self, image: Any) -> Any:
        """What :meth:`sample_adjoints` takes, for the adjoint of the image that all samples so far develop to (TensorXf
        of its shape)."""
        sums, kept = self._sum_type(self._sums), self._sums
        dr.enable_grad(sums)
        self._sums = sums
        developed = self.develop()
        self._sums = kept
        dr.set_grad(developed, image)
        dr.enqueue(dr.ADMode.Backward, developed)
        dr.traverse(dr.ADMode.Backward)
        found = dr.grad(sums)
        dr.eval(found)
        return found

    def sample_adjoints(self, adjoint: Any, where: Any, offset: Any) -> list[Any]:
        """The adjoint of each value of each sample (Floats) of a pass, given that of the sums; ``where`` and ``offset``
        as for :meth:`add`, pixels below ``pixel_count``."""
        t, taps, stride = self.types, self.filter.taps, self.channels + 1
        column, row = self._crop_pixel(where.pixel_and_sample()[0] if isinstance(where, Wavefront) else where)
        weights_x, weights_y = (self._tap_weights(place) for place in (offset.x, offset.y))
        found = [t.Float(0)] * self.channels
        for j in range(2 * taps + 1):
            for i in range(2 * taps + 1):
                x, y = column + (i - taps), row + (j - taps)
                index, inside = t.UInt(y * self._columns + x) * stride, self._inside(x, y)
                weight = weights_x[i] * weights_y[j]
                parts = [dr.gather(self._sum_type, adjoint, index + c, inside) for c in range(self.channels)]
                found = [dr.fma(weight, t.Float(part), total) for part, total in zip(parts, found, strict=True)]
        return found

    def weights(self) -> Any:
        """The sum of filter weights in each pixel, TensorXf (height, width, 1)."""
        t = self.types
        index = dr.arange(t.UInt, self.width * self.height) * (self.channels + 1) + self.channels
        return t.TensorXf(t.Float(dr.gather(self._sum_type, self._sums, index)), (self.height, self.width, 1))

    def non_finite_samples(self) -> int:
        """How many samples so far had a NaN or an infinity in some channel and were left out."""
        return int(np.array(self._bad).sum(dtype=np.uint64))

    def _crop_pixel(self, pixel: Any) -> tuple[Any, Any]:
        """Column and row (Int) of ``pixel`` in the crop window, negative in the border."""
        Int = self.types.Int
        y = pixel // self._sampled_columns
        x = pixel - y * self._sampled_columns
        return Int(x) - self.border, Int(y) - self.border

    def _inside(self, x: Any, y: Any) -> Any:
        return (x >= 0) & (x < self._columns) & (y >= 0) & (y < self._rows)

    def _splat(self, pixel: Any, offset: Any, values: list[Any], active: Any) -> None:
        """Every sample adds to all pixels that its filter reaches."""
        t = self.types
        taps = self.filter.taps
        column, row = self._crop_pixel(pixel)
        weights_x, weights_y = (self._tap_weights(place) for place in (offset.x, offset.y))
        sums = dr.zeros(self._sum_type, self.width * self.height * len(values))
        for j in range(2 * taps + 1):
            for i in range(2 * taps + 1):
                x, y = column + (i - taps), row + (j - taps)
                inside = active & self._inside(x, y)
                index = t.UInt(y * self._columns + x) * len(values)
                weight = weights_x[i] * weights_y[j]
                for channel, value in enumerate(values):
                    dr.scatter_add(sums, self._sum_type(value * weight), index + channel, inside)
        self._sums = self._sums + sums

    def _tap_weights(self, place: Any) -> list[Any]:
        if self.filter.is_box:
            return [self.types.Float(1)]
        taps = self.filter.taps
        return [self.filter.eval((k - taps + 0.5) - place) for k in range(2 * taps + 1)]

    def _sum_blocks(self, wavefront: Wavefront, values: list[Any]) -> None:
        """The box filter: every pixel sums its own block of lanes, in a fixed order."""
        t = self.types
        sums = [self._sum_type(value) + dr.zeros(self._sum_type, wavefront.size) for value in values]
        dr.eval(sums)
        sums = [dr.block_sum(value, wavefront.samples, mode="evaluated") for value in sums]
        pixel = dr.arange(t.UInt, wavefront.pixels) + dr.opaque(t.UInt, wavefront.first_pixel)
        x, y = self._crop_pixel(pixel)
        self._accumulate(t.UInt(y * self._columns + x), sums, self._inside(x, y))

    def _gather(self, wavefront: Wavefront, offset: Any, values: list[Any]) -> None:
        """Every pixel sums, in a fixed order, the samples that reach it: along columns, then along rows."""
        t = self.types
        taps = self.filter.taps
        places = store_packets(t, [offset.x, offset.y], wavefront.size)
        # Four values at a time: more sums than that do not stay in registers.
        groups = [values[i : i + 4] for i in range(0, len(values), 4)]
        stored = [store_packets(t, group, wavefront.size) for group in groups]
        rows = (wavefront.first_pixel, wavefront.first_pixel + wavefront.pixels - 1)
        low, high = (pixel // self.sampled_width - self.border for pixel in rows)
        low, high = max(low - taps, 0), min(high + taps, self.height - 1)
        if low > high:
            return
        target = dr.arange(t.UInt, (high - low + 1) * self.width) + dr.opaque(t.UInt, low * self.width)
        row = target // t.UInt(self._columns)
        column = t.Int(target - row * t.UInt(self._columns)) + self.border
        row = row - dr.opaque(t.UInt, low)
        sums = []
        for group, packets in zip(groups, stored, strict=True):
            by_tap = self._gather_columns(wavefront, low, high, places, packets, len(group))
            totals = [dr.zeros(self._sum_type, dr.width(target)) for _ in group]
            for i, buffers in enumerate(by_tap):
                # Unsigned, so that what lies left of the first column is refused too.
                source = t.UInt(column + (taps - i))
                present = source < self._sampled_columns
                part = load_packets(self._sum_types, buffers, len(group), row * self._sampled_columns + source, present)
                totals = [total + value for total, value in zip(totals, part, strict=True)]
            sums += totals
        self._accumulate(target, sums)

    def _gather_columns(
        self, wavefront: Wavefront, low: int, high: int, places: list[Any], packets: list[Any], fields: int
    ) -> list[list[Any]]:
        """Per horizontal tap, packets of what each sampled column brings to each row from ``low`` to ``high``."""
        t = self.types
        taps = self.filter.taps
        count = (high - low + 1) * self.sampled_width
        lane = dr.arange(t.UInt, count)
        row = lane // self._sampled_columns
        column = lane - row * self._sampled_columns
        y = t.Int(row) + dr.opaque(t.Int, low + self.border)
        first, pixels = dr.opaque(t.UInt, wavefront.first_pixel), dr.opaque(t.UInt, wavefront.pixels)
        samples = dr.opaque(t.UInt, wavefront.samples)

        def body(dy: Any, sample: Any, sums: list[list[Any]]) -> tuple[Any, Any, list[list[Any]]]:
            # Unsigned comparisons refuse what lies before the first row, or the first pixel, too.
            source = t.UInt(y + dy)
            pixel = source * self._sampled_columns + column - first
            present = (source < self._sampled_rows) & (pixel < pixels)
            index = pixel * samples + sample
            place_x, place_y = load_packets(t, places, 2, index, present)
            # Lanes that hold no sample read zeros.
            values = load_packets(t, packets, fields, index, present)
            weight_y = self.filter.eval(0.5 - place_y - t.Float(dy))
            weights = [weight * weight_y for weight in self._tap_weights(place_x)]
            sums = [
                [total + self._sum_type(value * weight) for total, value in zip(tap, values, strict=True)]
                for tap, weight in zip(sums, weights, strict=True)
            ]
            sample = sample + 1
            done = sample == samples
            return dr.select(done, dy + 1, dy), dr.select(done, 0, sample), sums

        start = [[dr.zeros(self._sum_type, count) for _ in range(fields)] for _ in range(2 * taps + 1)]
        state = (dr.full(t.Int, -taps, count), dr.zeros(t.UInt, count), start)
        *_, sums = dr.while_loop(state, lambda dy, sample, sums: dy <= taps, body)
        return [store_packets(self._sum_types, tap, count) for tap in sums]

    def _accumulate(self, pixel: Any, sums: list[Any], active: Any = True) -> None:
        """Add to distinct pixels of the crop window."""
        start = pixel * len(sums)
        totals = [dr.gather(self._sum_type, self._sums, start + i, active) + value for i, value in enumerate(sums)]
        for i, total in enumerate(totals):
            dr.scatter(self._sums, total, start + i, active)


def _convert(pixel_format: str, values: list[Any]) -> list[Any]:
    """``values`` with the first three, red, green and blue, in the colour space of ``pixel_format``."""
    matrix = {"luminance": (_LUMINANCE,), "xyz": _XYZ}.get(pixel_format.removesuffix("_alpha").removesuffix("a"))
    if matrix is None or len(values) < 3:
        return values
    red, green, blue, *rest = values
    return [r * red + g * green + b * blue for r, g, b in matrix] + rest


def _check(desc: FilmDescription, channels: int) -> None:
    if channels < 1:
        raise ValueError(f"a film needs at least one channel, not {channels}")
    if min(desc.width, desc.height, desc.crop_width, desc.crop_height) < 1:
        raise _error("the film or its crop window has no pixels", "give it a width and height of at least 1")
    if (
        min(desc.crop_offset_x, desc.crop_offset_y) < 0
        or desc.crop_offset_x + desc.crop_width > desc.width
        or desc.crop_offset_y + desc.crop_height > desc.height
    ):
        raise _error("the crop window reaches outside the film", "keep it within width and height")


def _error(message: str, remedy: str) -> SceneError:
    return SceneError([Problem(f"film: {message}", remedy=remedy)])
