"""Where shadows end on surfaces: for light that is found by sampling lights, points of which cast them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..job import Job
from ..rays.ray import Ray
from ..surfaces.hit import Hit
from ..types import types as make_types
from . import film_side
from .choose import Choice
from .curves import Curves
from .light_points import LightKind, ray_past
from .round_curves import Eye

#: Of so many curves one is taken that ends a surface as seen from the light.
_CANDIDATES = 16


@dataclass(frozen=True, eq=False)
class Casting:
    """``curves`` that cast shadows of ``kind``, drawn by ``choice``; on the surfaces for which ``receives`` (UInt
    buffer) is not 0, or on all if None."""

    kind: LightKind
    curves: Curves
    choice: Choice
    receives: Any


@dataclass(frozen=True, eq=False)
class ShadowPoint:
    """Points ``si`` of the edges of shadows, where ``active``, all without derivatives: of the points ``u`` of lights.

    ``along`` (Array3f) is how the point moves on the surface per unit of the curve's parameter, drawn with the density
    ``chance``; ``plane`` the unit normal of the plane in which light passes the edge, ``reach`` the largest coordinate
    involved. ``moved`` gives the point (Array3f) with derivatives, where ``p`` is how the lit surface's point moves.
    """

    casting: Casting
    u: Any
    eye: Eye
    index: Any
    s: Any
    chance: Any
    ray: Ray
    hit: Hit
    si: Any
    along: Any
    plane: Any
    reach: Any
    active: Any

    def moved(self, structure: Any, p: Any) -> Any:
        ray = self.ray
        eye = self.casting.kind.eye_for(self.u, self.eye, p, self.active)
        x = self.casting.curves.at(self.index, self.s, eye).x
        if eye.parallel:
            again = Ray.of(dr.replace_grad(ray.o, x), dr.replace_grad(ray.d, -eye.at + 0 * x), ray.tmin, ray.tmax)
        else:
            o = eye.at + 0 * x
            again = Ray.of(dr.replace_grad(ray.o, o), dr.replace_grad(ray.d, x - o), ray.tmin, ray.tmax)
        return structure.interact(again, self.hit).p


def cast(job: Job, casting: Casting, sampler: Any, count: int, first: int, total: int) -> ShadowPoint:
    """The samples ``first`` to ``first + count`` of ``total``."""
    t, structure = job.traced.types, job.traced.structure
    kind, curves = casting.kind, casting.curves
    u = sampler.next_2d()
    dr.eval(u, sampler.rng)
    eye = kind.eye(u)
    dr.eval(eye.at)
    lane = dr.arange(t.UInt, count) + dr.opaque(t.UInt, first)
    index, s, chance = _casting_curve(casting, eye, u, lane, total, sampler)
    dr.eval(index, s, chance, sampler.rng)

    # Past the curve, just outside of what it bounds, to what is met in its shadow.
    point = curves.at(index, s, eye)
    active = (chance > 0) & point.hides
    plane = dr.cross(eye.way_from(point.x), point.along)
    size = dr.norm(plane)
    active &= size > 0
    plane = plane / dr.select(size > 0, size, 1)
    outwards = plane * dr.mulsign(t.Float(1), dr.dot(plane, point.x - point.inner))
    largest = film_side.reach(point.x, eye.at if not eye.parallel else point.x)
    beside = point.x + outwards * (largest * (film_side.SHADOW_CLEARANCE * t.epsilon))
    ray = ray_past(eye, beside, largest, t.epsilon)
    if not eye.parallel:
        active &= ~structure.occluded(Ray.of(ray.o, ray.d, film_side.NEAR, 1 - film_side.NEAR), active)
    hit = structure.intersect(ray, active)
    dr.eval(hit, ray)
    si = structure.interact(ray, hit)
    active &= si.valid
    if casting.receives is not None:
        active &= dr.gather(t.UInt, casting.receives, si.surface, active) != 0

    slope = dr.dot(si.n, ray.d)
    active &= slope != 0
    grown = 1.0 if eye.parallel else hit.t
    along = point.along * grown
    along = along - ray.d * (dr.dot(si.n, along) / dr.select(active, slope, 1))
    # Rays to lights leave surfaces from beside them.
    reach = largest * grown + si.p_error * (1 / t.epsilon)
    return ShadowPoint(casting, u, eye, index, s, chance, ray, hit, si, along, plane, reach, active)


def casts(job: Job, bounces: int) -> bool:
    """Whether surfaces are lit by lights that rays are sent to, ``bounces`` from what the camera sees."""
    scene, settings = job.traced, job.settings
    if settings.kind == "direct":
        lit = settings.emitter_samples > 0 and not bounces
    else:
        lit = settings.max_depth < 0 or settings.max_depth - bounces > 1
    return lit and bool(scene.lights.count) and scene.materials.has_smooth_any


def material_share(job: Job) -> float:
    """How many samples are taken of materials for one of lights."""
    settings = job.settings
    return 1.0 if settings.kind == "path" else settings.bsdf_samples / settings.emitter_samples


def _casting_curve(casting: Casting, eye: Eye, u: Any, lane: Any, total: int, sampler: Any) -> tuple[Any, Any, Any]:
    """A curve that ends a surface as seen from ``eye``, where on it, and with which probability (0 for none): one of
    those among some candidates (resampling: Talbot, Cline and Egbert, EGSR 2005)."""
    t, wide, kind = casting.curves.types, make_types("float64").Float, casting.kind
    own = kind.rounded(u)
    width = dr.width(lane)
    scale = dr.opaque(wide, 1 / total)

    def step(i: Any, found: Any, index: Any, s: Any, chance: Any, sampler: Any) -> tuple[Any, ...]:
        # Strata that go on in turn, other ones for each candidate.
        place = (wide(lane) + wide(sampler.next_1d())) * scale + wide(i) * (1 / _CANDIDATES)
        number, probability, rest = casting.choice.draw(place - dr.floor(place))
        good = casting.curves.at(number, rest, eye).hides & (probability > 0)
        if own is not None:
            good &= kind.scene.lights.light_of(casting.curves.outlined(number), good) != own
        found = dr.select(good, found + 1, found)
        taken = good & (sampler.next_1d() * t.Float(found) < 1)
        return (
            i + 1, found, dr.select(taken, number, index), dr.select(taken, rest, s),
            dr.select(taken, probability, chance), sampler,
        )  # fmt: skip

    none, zero = dr.zeros(t.UInt, width), dr.zeros(t.Float, width)
    state = (none, none + 0, none + 0, zero, zero + 0, sampler)
    _, found, index, s, chance, done = dr.while_loop(state, lambda i, *_: i < _CANDIDATES, step, label="casting curve")
    sampler.rng = done.rng
    return index, s, chance * _CANDIDATES / dr.select(found > 0, t.Float(found), 1)
