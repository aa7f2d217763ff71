"""Where shadows end on what the camera sees: for light that is found by sampling lights, points of which cast them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..integrators.tracing import StructureTracing
from ..job import Job
from ..rays.film_map import FilmMap
from ..rays.ray import Ray
from ..types import types as make_types
from . import film_side
from .choose import Choice
from .crossings import Crossings, random_numbers, twice
from .curves import Curves
from .light_points import LightKind, ray_past
from .round_curves import Eye

#: Of so many curves one is taken that ends a surface as seen from the light.
_CANDIDATES = 16
_NEAR = 0.01


@dataclass(frozen=True, eq=False)
class Casting:
    """``curves`` that cast shadows of ``kind``, drawn by ``choice``; on the surfaces for which ``receives`` (UInt
    buffer) is not 0, or on all if None."""

    kind: LightKind
    curves: Curves
    choice: Choice
    receives: Any


def shadow_edges(job: Job, casting: Casting, seed: Any, count: int, first: int, total: int) -> Crossings:
    """The samples ``first`` to ``first + count`` of ``total``, drawn from ``seed``."""
    view, t = job.view, job.traced.types
    camera, film, structure = view.camera, view.film, job.traced.structure
    kind, curves = casting.kind, casting.curves
    sampler = random_numbers(job, seed, count, first)
    u = sampler.next_2d()
    dr.eval(u, sampler.rng)
    eye = kind.eye(u)
    dr.eval(eye.at)
    lane = dr.arange(t.UInt, count) + dr.opaque(t.UInt, first)
    index, s, chance = _casting_curve(casting, eye, u, lane, total, sampler)
    aperture = sampler.next_2d() if camera.needs_aperture_sample else None
    dr.eval(index, s, chance, aperture, sampler.rng)

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
        active &= ~structure.occluded(Ray.of(ray.o, ray.d, _NEAR, 1 - _NEAR), active)
    hit = structure.intersect(ray, active)
    dr.eval(hit, ray)
    si = structure.interact(ray, hit)
    active &= si.valid
    if casting.receives is not None:
        active &= dr.gather(t.UInt, casting.receives, si.surface, active) != 0

    # How the shadow's edge runs, on the surface and on the film.
    back = FilmMap.of(camera, aperture)
    slope = dr.dot(si.n, ray.d)
    active &= slope != 0
    grown = 1.0 if eye.parallel else hit.t
    along = point.along * grown
    along = along - ray.d * (dr.dot(si.n, along) / dr.select(active, slope, 1))
    x, y, depth = back.weights(si.p)
    active &= depth > 0
    depth = dr.select(active, depth, 1)
    at = dr.select(active, x / depth, -1), dr.select(active, y / depth, -1)
    active &= film.pixel_at(*at)[2]
    across = film_side.across(film, back.tangent(si.p, along))
    step = film_side.steps(film, across)
    seen = camera.sample_ray(t.Array2f(*at), aperture)
    way = film_side.lateral(back, step, depth)
    tilt = dr.dot(si.n, seen.d)
    active &= tilt != 0
    way = way - seen.d * (dr.dot(si.n, way) / dr.select(active, tilt, 1))
    reach = film_side.reach(si.p, si.p - back.base, back.base, back.du * depth, back.dv * depth)
    # Rays to lights leave surfaces from beside them.
    reach = dr.fmax(reach, largest * grown) + si.p_error * (1 / t.epsilon)
    size = film_side.clear_of_rounding(way, plane, reach, film_side.SHADOW_CLEARANCE * t.epsilon)
    active &= size < 1
    hidden = t.Bool(True) if job.settings.hide_emitters else None
    first_hit = StructureTracing(job.traced).closest(seen, active, hidden)
    far = dr.dot(si.p - seen.o, seen.d)
    active &= first_hit.valid & (dr.abs(first_hit.t - far) < far * _NEAR)
    dr.eval(at, step, size, across, active, first_hit)

    # The light of that same point of the light on either side.
    both = dr.arange(t.UInt, 2 * count)
    half, sign = both >> 1, dr.select((both & 1) == 0, t.Float(-1), 1)
    where, step_there = (t.Array2f(*(dr.gather(t.Float, v, half) for v in pair)) for pair in (at, step))
    where = where + step_there * (dr.gather(t.Float, size, half) * sign)
    lens = None if aperture is None else dr.gather(t.Array2f, aperture, half)
    light = _light_seen(job, kind, where, lens, dr.gather(t.Array2f, u, half), twice(sampler, half),
                        dr.gather(t.Bool, active, half))  # fmt: skip
    dr.eval(light)
    own = dr.arange(t.UInt, count) * 2
    jump = dr.gather(t.Array3f, light, own) - dr.gather(t.Array3f, light, own + 1)
    per_sample = dr.opaque(t.Float, job.sampler.sample_count / total)
    scale = per_sample * curves.share(index) / dr.select(active, chance, 1)

    def position() -> tuple[Any, Any]:
        p = structure.interact(camera.sample_ray(t.Array2f(*at), aperture), first_hit).p
        moving = kind.eye_for(u, eye, p, active)
        x = curves.at(index, s, moving).x
        if moving.parallel:
            again = Ray.of(dr.replace_grad(ray.o, x), dr.replace_grad(ray.d, -moving.at + 0 * x), ray.tmin, ray.tmax)
        else:
            o = moving.at + 0 * x
            again = Ray.of(dr.replace_grad(ray.o, o), dr.replace_grad(ray.d, x - o), ray.tmin, ray.tmax)
        x, y, depth = FilmMap.of(camera, aperture).weights(structure.interact(again, hit).p)
        depth = dr.select(active, depth, 1)
        return film_side.pixels(film, (x / depth, y / depth))

    return Crossings(film, at, jump, (across[0] * scale, across[1] * scale), active, position)


def casts(job: Job) -> bool:
    """Whether surfaces are lit by lights that rays are sent to."""
    scene, settings = job.traced, job.settings
    if settings.kind == "direct":
        one_bounce = settings.emitter_samples > 0
    else:
        one_bounce = settings.max_depth < 0 or settings.max_depth > 1
    return one_bounce and bool(scene.lights.count) and scene.materials.has_smooth_any


def _material_share(job: Job) -> float:
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


def _light_seen(job: Job, kind: LightKind, at: Any, lens: Any, u: Any, sampler: Any, active: Any) -> Any:
    """The light of the point ``u`` of a light that what is seen at film position ``at`` sends to the camera."""
    view, scene, t = job.view, job.traced, job.traced.types
    ray, differential = view.differentials.start(view.camera, at, lens)
    hidden = t.Bool(True) if job.settings.hide_emitters else None
    hit = StructureTracing(scene).closest(ray, active, hidden)
    meeting = view.differentials.meet(scene.structure, ray, differential, hit)
    if scene.draws_texels:
        meeting = meeting.drawing(sampler.next_2d())
    si = meeting.si
    active = active & si.valid
    return kind.light(si, u, scene.material(si, active), _material_share(job), active)
