"""Differentials by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from ...errors import SettingError
from ..ray import Ray
from .analytic import Analytic
from .autodiff import Autodiff
from .autodiff2 import Autodiff2
from .cone import Cone
from .distance import Distance
from .finite import Finite
from .none import NO_DIFFERENTIALS
from .state import Meeting


class Bouncing(Protocol):
    """What a bounce asks of differentials. ``state`` travels with the ray, in a loop's state."""

    def meet(self, structure: Any, ray: Ray, state: Any, hit: Any) -> Meeting:
        """What is where ``ray`` met a surface of ``structure`` at ``hit``."""
        ...

    def leave(self, meeting: Meeting, sample: Any, ray: Ray, state: Any) -> Any:
        """The state of ``ray``, which goes on from ``meeting`` in the direction that ``sample`` chose."""
        ...


class Differentials(Bouncing, Protocol):
    """A way to know how rays change from sample to sample."""

    def start(self, camera: Any, position: Any, aperture: Any) -> tuple[Ray, Any]:
        """The camera's ray through ``position`` of the film, and its state."""
        ...


DIFFERENTIALS: dict[str, Callable[[tuple[Any, Any], float], Differentials]] = {
    "none": lambda step, spacing: NO_DIFFERENTIALS,
    "distance": Distance,
    "cone": Cone,
    "finite": Finite,
    "analytic": Analytic,
    "autodiff": Autodiff,
    "autodiff2": Autodiff2,
}


def check_differentials(name: str) -> None:
    """``SettingError`` unless there are differentials called ``name``."""
    if name not in DIFFERENTIALS:
        raise SettingError(f"unknown differentials {name!r}; there are {', '.join(DIFFERENTIALS)}")


def make_differentials(name: str, step: tuple[Any, Any], spacing: float) -> Differentials:
    """The differentials called ``name`` for samples that are ``step`` (x, y) of the film's width and height apart,
    ``spacing`` in pixels."""
    check_differentials(name)
    return DIFFERENTIALS[name](step, spacing)
