"""Places where what is integrated for the image jumps, and what it is worth that they move.

At a curve on the film along which the radiance jumps, or in the directions that a surface gathers light from, the image
changes by the jump times the way that the curve moves across itself (Li, Aittala, Durand and Lehtinen, "Differentiable
Monte Carlo ray tracing through edge sampling", SIGGRAPH Asia 2018, section 3; Reynolds' transport theorem).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr

from ..film import Film
from ..job import Job
from ..rays.independent import Independent
from ..rays.wavefront import Wavefront


class Crossings:
    """Sampled points of such curves, one a lane, all without derivatives but for what ``position`` gives.

    ``at`` is the film position of what is integrated, ``jump`` (Floats, one for each of the film's channels, or an
    Array3f where none but the first three jump) that on one side less that on the other, ``across`` (Floats, a vector)
    points to the other: it is as long as the way along the curve, over the density of the sample. ``position`` gives
    the place of the curve (as many Floats), which follows what moves.
    """

    def __init__(
        self, film: Film, at: tuple[Any, Any], jump: Any, across: Sequence[Any], active: Any,
        position: Callable[[], Sequence[Any]],
    ) -> None:  # fmt: skip
        self.pixel, self.offset, inside = film.pixel_at(*at)
        usable = active & inside
        for x in (*jump, *across):
            usable &= dr.isfinite(x)
        self.jump = [dr.select(usable, x, 0) for x in jump]
        self.across = [dr.select(usable, x, 0) for x in across]
        self.active, self._position = usable, position
        dr.eval(self.pixel, self.offset, self.jump, self.across, self.active)

    def moved(self) -> list[Any]:
        """The place of the curve, with derivatives; 0 where there is nothing."""
        return [dr.select(self.active, x, 0) for x in self._position()]

    def backward(self, film: Film, adjoint: Any) -> None:
        """Adds to the gradients, given the adjoint of the film's sums."""
        adjoints = film.sample_adjoints(adjoint, self.pixel, self.offset)
        weight = sum(j * a for j, a in zip(self.jump, adjoints, strict=False))
        total = sum(dr.detach(weight * a) * x for a, x in zip(self.across, self.moved(), strict=True))
        total = dr.select(self.active, total, 0)
        if dr.grad_enabled(total):
            dr.backward_from(total)

    def forward(self, film: Film) -> None:
        """Adds to the film how the image changes for the tangents that there are."""
        moved = [-x for x in self.moved()]
        ends = [end for end in moved if dr.grad_enabled(end)]
        if ends:
            dr.forward_to(ends, flags=dr.ADFlag.ClearEdges | dr.ADFlag.ClearInterior)
        way = -sum(dr.grad(x) * a for a, x in zip(self.across, moved, strict=True))
        still = [type(way)(0)] * (film.channels - len(self.jump))
        film.add_to_sums(self.pixel, self.offset, [*(j * way for j in self.jump), *still], self.active)


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
