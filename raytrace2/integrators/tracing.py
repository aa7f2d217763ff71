"""The questions that a bounce asks of a scene's surfaces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import drjit as dr

from ..materials.sample import BsdfSample
from ..rays.differentials import Meeting
from ..rays.ray import Ray
from ..scene.traced import TracedScene
from ..surfaces.hit import Hit
from .emission import past_emitters


class Tracing(Protocol):
    """Who answers them: the scene's structure, or the memory of what it answered.

    ``keeps_gradients``: whether rays that go on and samples may carry derivatives other than those for footprints.
    ``follows_black``: whether paths go on where nothing is reflected, for how much that is may have derivatives.
    ``holds_directions``: whether directions that smooth lobes chose stay what they are in the world when surfaces move.
    """

    keeps_gradients: bool
    follows_black: bool
    holds_directions: bool

    def closest(self, ray: Ray, active: Any, hidden: Any) -> Hit:
        """What each ray meets first, lights left out where they are ``hidden`` (Bool; None: nowhere)."""

    def blocked(self, ray: Ray, active: Any) -> Any:
        """Bool: whether anything lies on each ray."""


class StructureTracing:
    """Answers of the scene's own structure."""

    keeps_gradients = False
    follows_black = False
    holds_directions = False

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


def held(scene: TracedScene, meeting: Meeting, material: Any, sample: BsdfSample, active: Any) -> BsdfSample:
    """``sample`` with the derivatives of one whose direction is what it is in the world, and was chosen with a density
    that is what it is; only the material's value has some. Deltas are as they are."""
    si, scatter = meeting.si, meeting.scatter
    wo = scatter.to_local(dr.detach(scatter.to_world(sample.wo)))
    value, pdf = scene.materials.eval_pdf(si, material, wo, active)
    smooth = active & ~sample.delta & (pdf > 0)
    weight = value / dr.detach(dr.select(smooth, pdf, 1))
    return replace(
        sample,
        wo=dr.replace_grad(sample.wo, dr.select(smooth, wo, sample.wo)),
        weight=dr.replace_grad(sample.weight, dr.select(smooth, weight, sample.weight)),
        pdf=dr.replace_grad(sample.pdf, dr.select(smooth, pdf, sample.pdf)),
    )
