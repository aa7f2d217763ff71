"""Bitmap textures: where a texel of one of many images lies, and what it holds. Filters build on this."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from ..buffers import owned
from ..live import STILL, Live, Slot, Values
from ..rays.footprint import Footprint
from ..scene.description import BitmapTexture
from ..types import Types
from .block_means import BlockMeans
from .filter_settings import FilterSettings
from .filters import FILTERS
from .pyramid import Pyramid
from .replayed import finite
from .texels import Texels
from .uv_transform import UvTransforms
from .wrap import CLAMP, MODES, wrap

_POINT = {"nearest": 0, "bilinear": 1}


@dataclass
class Image:
    """One image a lane: ``offset`` UInt (texels before it), ``width`` and ``height`` Float.

    ``mode`` and ``filter`` (UInt) and ``srgb`` (Bool) are None where all images agree. ``place`` (UInt) is that of the
    bitmap; ``coarse`` and ``scale`` are those of a pyramid's levels.
    """

    offset: Any
    width: Any
    height: Any
    mode: Any
    filter: Any
    srgb: Any
    place: Any = None
    coarse: Any = None
    scale: Any = None


class Bitmaps:
    """Images of one storage format (see :class:`~raytrace2.textures.texels.Texels`), by place.

    Texel (column i, row j) covers u in [i, i + 1] / width, v in [j, j + 1] / height: as in Mitsuba, row 0 is at v = 0.
    Wrap modes, filters and sRGB decoding are part of the kernel only where they differ between images. ``settings``
    take the place of every image's own filter.
    """

    def __init__(
        self,
        bitmaps: Sequence[BitmapTexture],
        types: Types,
        settings: FilterSettings | None = None,
        live: Live = STILL,
    ) -> None:
        images = [b.pixels for b in bitmaps]
        srgb = [image.dtype == np.uint8 and not b.raw for b, image in zip(bitmaps, images, strict=True)]
        modes = [MODES[b.wrap_mode] for b in bitmaps]
        filters = [_POINT[b.filter_type] if settings is None else 0 for b in bitmaps]
        self.texels = Texels(images, srgb, types)
        self.channels = self.texels.channels
        self._to_uv = UvTransforms([b.to_uv for b in bitmaps], types, [live.place(b, "to_uv") for b in bitmaps])
        self._live = {k: p for k, b in enumerate(bitmaps) if (p := live.place(b, "pixels")) is not None}
        self._types = types
        self._settings = settings
        self._modes = frozenset(modes)
        self._filters = frozenset(filters)
        self._mixed_srgb = len(set(srgb)) > 1
        self._count = len(images)
        sizes = np.array([image.shape[1::-1] for image in images], dtype=np.uint32)
        #: Texels of the longest side of all images.
        self.longest = int(sizes.max())
        self.pyramid: Pyramid | None = None
        if settings is not None and settings.needs_pyramid:
            self.pyramid = Pyramid(self.texels, sizes, srgb, modes, types, settings.pyramid)
        self.blocks: BlockMeans | None = None
        if settings is not None and settings.needs_blocks:
            near = [b.filter_type == "nearest" for b in bitmaps]
            self.blocks = BlockMeans(self.texels, sizes, srgb, modes, near, types)
        flags = np.array(modes) | np.array(filters) << 2 | np.array(srgb, dtype=np.int64) << 3
        records = np.column_stack([self.texels.offsets, sizes, flags]).astype(np.uint32)
        if self._count == 1:
            self._record: Any = [owned(field, types.UInt) for field in records[0]]
        else:
            self._record = owned(records, types.UInt)

    def eval(self, place: Any, uv: Any, footprint: Any, active: Any) -> Any:
        """The filtered texture at ``uv`` of the surface, over the ``footprint`` there (None if there is none): Array3f,
        or Float where there is one channel.

        Derivatives by ``uv`` and by the footprint that would be infinite or NaN are 0.
        """
        if footprint is None or self._settings is None or not self._settings.needs_footprint:
            return self._derived(place, uv, None, active)
        what = (id(self), place, self._types.Bool(active), dr.grad_enabled(uv, footprint))
        return footprint.once(what, lambda: self._derived(place, uv, footprint, active))

    def _derived(self, place: Any, uv: Any, footprint: Footprint | None, active: Any) -> Any:
        if dr.grad_enabled(uv):
            uv = finite(uv)
        if footprint is not None and dr.grad_enabled(footprint):
            footprint = footprint.mapped(finite)
        return finite(self._look_up(place, uv, footprint, active))

    def _look_up(self, place: Any, uv: Any, footprint: Footprint | None, active: Any) -> Any:
        image = self.image(place, active)
        at = self._to_uv.apply(place, uv, active)
        if self._settings is not None:
            return self._over(image, at, self._in_texels(image, place, footprint, active), active)
        if len(self._filters) == 1:
            name = "bilinear" if _POINT["bilinear"] in self._filters else "nearest"
            return FILTERS[name](self, image, at, None, FilterSettings(name), active)
        smooth, near = (FILTERS[name](self, image, at, None, FilterSettings(name), active) for name in reversed(_POINT))
        return dr.select(image.filter == _POINT["bilinear"], smooth, near)

    def _over(self, image: Image, uv: Any, footprint: Footprint | None, active: Any) -> Any:
        settings = self._settings
        assert settings is not None
        # Where nothing is known of the footprint it is taken for a point.
        name = "bilinear" if footprint is None and settings.needs_footprint else settings.name
        return FILTERS[name](self, image, uv, footprint, settings, active)

    def _in_texels(self, image: Image, place: Any, footprint: Footprint | None, active: Any) -> Footprint | None:
        if footprint is None:
            return None
        linear = self._to_uv.apply_linear(place, active)

        def texels(v: Any) -> Any:
            v = linear(v)
            return type(v)(v.x * image.width, v.y * image.height)

        return footprint.mapped(texels)

    def slots(self, *, moves: bool) -> list[Slot]:
        """Those of live maps of uv and of live pixels (TensorXf of the shape of the image), with all that is made of
        them. 8-bit pixels are not live."""
        found = self._to_uv.slots(moves=moves)
        if not self._live or self.texels.is_bytes:
            return found

        def images(values: Values) -> dict[int, Any]:
            return {k: self._types.Float(values(place).array) for k, place in self._live.items()}

        def texels(base: Any, values: Values) -> Any:
            given = images(values)
            return self.texels.with_images(base, given, self.pyramid.appended(given) if self.pyramid else {})

        found.append(Slot.of(self.texels, "_buffer", self._live.values(), texels, moves=moves))
        if self.blocks is not None:
            blocks = self.blocks

            def made(base: Any, values: Values) -> Any:
                return blocks.with_images(base, images(values))

            found.append(Slot.of(blocks, "data", self._live.values(), made, moves=moves))
        return found

    def held_elsewhere(self) -> list[Any]:
        """Arrays that :meth:`slots` read besides what they are of, which functions that are to be frozen must know."""
        found = [] if self.pyramid is None else self.pyramid.constants(self._live)
        return found + ([] if self.blocks is None else self.blocks.constants(self._live))

    @property
    def buffers(self) -> tuple[Any, ...]:
        """What of all that look-ups read can carry derivatives by texels."""
        texels = self.texels._buffer
        return (texels,) if self.blocks is None else (texels, self.blocks.data[0])

    def image(self, place: Any, active: Any) -> Image:
        """The image at ``place``."""
        t = self._types
        if self._count == 1:
            offset, width, height, flags = self._record
        else:
            offset, width, height, flags = dr.gather(dr.uint32_array_t(t.Array4f), self._record, place, active)
        return Image(
            offset,
            t.Float(width),
            t.Float(height),
            flags & 3 if len(self._modes) > 1 else None,
            flags >> 2 & 1 if len(self._filters) > 1 else None,
            flags & 8 != 0 if self._mixed_srgb else None,
            place,
        )

    def wraps(self, mode: int) -> bool:
        """Whether there are images of a wrap mode."""
        return mode in self._modes

    def is_clamped(self, image: Image) -> Any:
        """Whether the ``image`` goes on as its edges do (Bool)."""
        return self._types.Bool(self.wraps(CLAMP)) if image.mode is None else image.mode == CLAMP

    def columns(self, image: Image, x: Any) -> tuple[Any, Any]:
        """Columns (Float, in range) of the texels ``x`` and ``x + 1``, after wrapping."""
        return wrap(x, image.width, image.mode, self._modes)

    def rows(self, image: Image, y: Any) -> tuple[Any, Any]:
        """Rows (Float, in range) of the texels ``y`` and ``y + 1``, after wrapping."""
        return wrap(y, image.height, image.mode, self._modes)

    def level(self, image: Image, level: Any, active: Any) -> Image:
        """The image at ``level`` (UInt) of its pyramid, which there must be; beyond its last level that."""
        assert self.pyramid is not None
        return self.pyramid.level(image, level, active)

    def two_levels(self, image: Image, level: Any, active: Any) -> tuple[Image, Image, Any]:
        """The image at ``level`` (UInt) of its pyramid and at the next one, and whether that is another (Bool)."""
        assert self.pyramid is not None
        return self.pyramid.two_levels(image, level, active)

    def texel(self, image: Image, column: Any, row: Any, active: Any) -> Any:
        """The linear value at a column and row that are in range: Array3f, or Float where there is one channel."""
        return self.several(image, [(column, row)], active)[0]

    def several(self, image: Image, places: Sequence[tuple[Any, Any]], active: Any) -> list[Any]:
        """:meth:`texel` of some ``places`` (column, row), for less than one by one."""
        u = self._types.UInt
        indices = [dr.fma(u(row), u(image.width), u(column)) + image.offset for column, row in places]
        if self.pyramid is not None:
            return self.pyramid.fetch(image, indices, active)
        return [self.texels.fetch(index, image.srgb, active) for index in indices]


def check_bitmap(bitmap: BitmapTexture) -> None:
    """``ValueError`` unless a table can hold the pixels: (height, width, 1 or 3), of a known type, 2^24 a side."""
    pixels = bitmap.pixels
    name = bitmap.filename or "a bitmap"
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3) or 0 in pixels.shape:
        raise ValueError(f"{name} must have the shape (height, width, 1 or 3), not {pixels.shape}")
    if max(pixels.shape) > 2**24:
        raise ValueError(f"{name} is {pixels.shape[1]} x {pixels.shape[0]}, beyond 2^24 texels a side; scale it down")
    if pixels.dtype not in (np.uint8, np.float16, np.float32, np.float64):
        raise ValueError(f"{name} has pixels of type {pixels.dtype}; uint8, float16, float32 and float64 are held")
