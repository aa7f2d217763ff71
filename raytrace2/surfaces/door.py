"""What users hand to queries: rays, masks and hits, checked before a kernel is made of them."""

from __future__ import annotations

from typing import Any, cast

import drjit as dr
import numpy as np

from ..arguments import shown
from ..types import Types
from .hit import Hit


def origin_of(ray: Any) -> Any:
    """The origins of a ray of ours or of Mitsuba's; ``TypeError`` for anything else."""
    origin = getattr(ray, "o", None)
    if origin is None or isinstance(ray, type) or not dr.is_jit_v(origin):
        raise TypeError(f"a Ray is needed, not {shown(ray)}; make one with Ray(o, d)")
    return origin


def checked_mask(active: Any, types: Types, width: int) -> Any:
    """``active`` as a Bool of one entry or of ``width``; ``TypeError`` or ``ValueError`` if it is no such mask."""
    if active is True or active is False:
        return types.Bool(active)
    if active is None or not dr.is_jit_v(active):
        array = np.asarray(active) if isinstance(active, list | tuple | np.ndarray | np.generic | int) else None
        if array is None or array.dtype.kind not in "biu" or array.ndim > 1:
            raise TypeError(f"active must be True, False or a mask with an entry a ray, not {shown(active)}")
        active = types.Bool(np.ascontiguousarray(np.atleast_1d(array), dtype=bool))
    else:
        active = types.Bool(active)
    entries = dr.width(active)
    if entries != width and (entries == 0 or (entries > 1 and width > 1)):
        raise ValueError(f"active has {entries} entries for {width} rays")
    return active


def checked_hit(hit: Any, width: int) -> Hit:
    """``hit``, whose fields all have one entry or one a ray; else ``TypeError`` or ``ValueError``."""
    fields = ("t", "prim", "uv", "surface", "instance")
    if isinstance(hit, type) or not all(hasattr(hit, name) for name in fields):
        raise TypeError(f"a Hit is needed, as intersect() returns it, not {shown(hit)}")
    widths = {name: dr.width(getattr(hit, name)) for name in fields}
    full = max(width, *widths.values())
    for name, entries in widths.items():
        if entries not in (1, full) or (width not in (1, full)):
            raise ValueError(f"the hit's {name} has {entries} entries for {full} rays")
    return cast(Hit, hit)
