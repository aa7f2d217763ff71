"""What a ray's differentials are after a bounce that chose its direction at random."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ...surfaces.frame import coordinate_system

#: A direction chosen with a density stands for directions of the solid angle 1 / density; footprints reach no farther
#: than this to a side of it, in radians.
WIDEST = 0.5


def widened(d: Any, pdf: Any, spacing: Any) -> tuple[Any, Any]:
    """Two derivatives (Array3f) of the direction ``d``, across it and each other, after sampling it with density
    ``pdf``.

    The square that they span has the solid angle 1 / pdf that the sample stands for, shrunk as samples of a pixel are:
    ``spacing`` is their distance in pixels (after Suykens and Willems, "Path differentials and applications", 2001).
    """
    reach = dr.fmin(dr.rsqrt(dr.select(pdf > 0, pdf, 1)) * spacing, WIDEST)
    s, t = coordinate_system(d)
    return s * reach, t * reach
