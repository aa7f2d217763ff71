"""How rays change from one sample to the next, carried from the camera through every bounce. One way a file."""

from .at_infinity import turns
from .choose import DIFFERENTIALS, Bouncing, Differentials, check_differentials, make_differentials
from .none import NO_DIFFERENTIALS
from .state import Meeting, RayDifferential
from .uv_partials import uv_partials

__all__ = [
    "DIFFERENTIALS",
    "NO_DIFFERENTIALS",
    "Bouncing",
    "Differentials",
    "Meeting",
    "RayDifferential",
    "check_differentials",
    "make_differentials",
    "turns",
    "uv_partials",
]
