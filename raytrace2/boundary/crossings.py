"""Places on the film where the image jumps, and what it is worth that they move.

At a curve on the film along which the radiance jumps, the image changes by the jump times the way that the curve moves
across itself (Li, Aittala, Durand and Lehtinen, "Differentiable Monte Carlo ray tracing through edge sampling",
SIGGRAPH Asia 2018, section 3; Reynolds' transport theorem).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from ..film import Film
from ..job import Job
from ..rays.independent import Independent
from ..rays.wavefront import Wavefront


class Crossings:
    """Sampled points of such curves, one a lane, all without derivatives but for what ``position`` gives.

    ``jump`` (Array3f) is the radiance on one side less that on the other, ``across`` (x, y) points to the other, in
    pixels: it is as long as the way along the curve, over the density of the sample. ``position`` gives the place on
    the film (two Floats), which follows what moves.
    """

    def __init__(
        self, film: Film, at: tuple[Any, Any], jump: Any, across: tuple[Any, Any], active: Any,
        position: Callable[[], tuple[Any, Any]],
    ) -> None:  # fmt: skip
        self.pixel, self.offset, inside = film.pixel_at(*at)
        usable = active & inside & dr.isfinite(across[0]) & dr.isfinite(across[1]) & dr.all(dr.isfinite(jump))
        self.jump = dr.select(usable, jump, 0)
        self.across = dr.select(usable, across[0], 0), dr.select(usable, across[1], 0)
        self.active, self._position, self._size = usable, position, (film.width, film.height)
        dr.eval(self.pixel, self.offset, self.jump, self.across, self.active)

    def moved(self) -> tuple[Any, Any]:
        """The place on the film in pixels, with derivatives; 0 where there is nothing."""
        x, y = self._position()
        Float = type(x)
        width, height = (dr.opaque(Float, n) for n in self._size)
        return dr.select(self.active, x * width, 0), dr.select(self.active, y * height, 0)

    def backward(self, film: Film, adjoint: Any) -> None:
        """Adds to the gradients, given the adjoint of the film's sums."""
        adjoints = film.sample_adjoints(adjoint, self.pixel, self.offset)
        weight = sum(j * a for j, a in zip(self.jump, adjoints, strict=True))
        weights = dr.detach(weight * self.across[0]), dr.detach(weight * self.across[1])
        x, y = self.moved()
        total = dr.select(self.active, weights[0] * x + weights[1] * y, 0)
        if dr.grad_enabled(total):
            dr.backward_from(total)

    def forward(self, film: Film) -> None:
        """Adds to the film how the image changes for the tangents that there are."""
        x, y = (-v for v in self.moved())
        ends = [end for end in (x, y) if dr.grad_enabled(end)]
        if ends:
            dr.forward_to(ends, flags=dr.ADFlag.ClearEdges | dr.ADFlag.ClearInterior)
        way = -(dr.grad(x) * self.across[0] + dr.grad(y) * self.across[1])
        film.add_to_sums(self.pixel, self.offset, [j * way for j in self.jump], self.active)


def random_numbers(job: Job, seed: Any, count: int, first: int) -> Independent:
    """Random numbers for the lanes ``first`` to ``first + count`` of all."""
    sampler = Independent(job.traced.types.precision, 1, 0)
    sampler.seed(seed, Wavefront(count, 1, first))
    return sampler


def twice(sampler: Independent, lane: Any) -> Independent:
    """The numbers that ``sampler`` goes on with in its lanes ``lane``."""
    rng = type(sampler.rng)()
    kind = type(rng.state)
    rng.state, rng.inc = dr.gather(kind, sampler.rng.state, lane), dr.gather(kind, sampler.rng.inc, lane)
    return Independent(sampler.precision, sampler.sample_count, sampler.base_seed, rng)
