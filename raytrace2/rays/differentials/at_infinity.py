"""How the direction of a ray changes from sample to sample, whatever way its differentials are carried."""

from __future__ import annotations

from typing import Any

from ...surfaces.frame import coordinate_system
from .distance import Beam
from .finite import OffsetRays
from .state import RayDifferential


def turns(d: Any, state: Any) -> tuple[Any, Any] | None:
    """The changes (Array3f) of the unit direction ``d`` towards the next sample to the right and down; None where
    nothing is known of them."""
    if isinstance(state, RayDifferential):
        return state.d_dx, state.d_dy
    if isinstance(state, OffsetRays):
        return state.d_x - d, state.d_y - d
    if isinstance(state, Beam):
        s, t = coordinate_system(d)
        return s * state.spread, t * state.spread
    return None
