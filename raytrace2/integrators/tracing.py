"""The questions that a bounce asks of a scene's surfaces."""

from __future__ import annotations

from typing import Any, Protocol

import drjit as dr

from ..rays.ray import Ray
from ..scene.traced import TracedScene
from ..surfaces.hit import Hit
from .emission import past_emitters


class Tracing(Protocol):
    """Who answers them: the scene's structure, or the memory of what it answered.

    ``keeps_gradients``: whether rays that go on and samples may carry derivatives other than those for footprints.
    ``follows_black``: whether paths go on where nothing is reflected, for how much that is may have derivatives.
    """

    keeps_gradients: bool
    follows_black: bool

    def closest(self, ray: Ray, active: Any, hidden: Any) -> Hit:
        """What each ray meets first, lights left out where they are ``hidden`` (Bool; None: nowhere)."""

    def blocked(self, ray: Ray, active: Any) -> Any:
        """Bool: whether anything lies on each ray."""


class StructureTracing:
    """Answers of the scene's own structure."""

    keeps_gradients = False
    follows_black = False

    def __init__(self, scene: TracedScene) -> None:
        self._scene = scene

    def closest(self, ray: Ray, active: Any, hidden: Any) -> Hit:
        hit = self._scene.structure.intersect(ray, active)
        return hit if hidden is None else past_emitters(self._scene, ray, hit, active & hidden)

    def blocked(self, ray: Ray, active: Any) -> Any:
        return self._scene.structure.occluded(ray, active)


def scatters(value: Any, pdf: Any, tracing: Tracing) -> Any:
    """Bool: where a material sends light of which something may follow, for its ``value`` and density ``pdf``."""
    bright = dr.max(value) > 0
    return bright | (pdf > 0) if tracing.follows_black else bright
