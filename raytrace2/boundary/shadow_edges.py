"""Where shadows end on what the camera sees, on the film."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..integrators.tracing import StructureTracing
from ..job import Job
from ..rays.film_map import FilmMap
from . import film_side
from .casting import Casting, cast, material_share
from .crossings import Crossings, random_numbers, twice
from .light_points import LightKind


def shadow_edges(job: Job, casting: Casting, seed: Any, count: int, first: int, total: int) -> Crossings:
    """The samples ``first`` to ``first + count`` of ``total``, drawn from ``seed``."""
    view, t = job.view, job.traced.types
    camera, film, structure = view.camera, view.film, job.traced.structure
    sampler = random_numbers(job, seed, count, first)
    shadow = cast(job, casting, sampler, count, first, total)
    si, active = shadow.si, shadow.active
    aperture = sampler.next_2d() if camera.needs_aperture_sample else None
    dr.eval(aperture, sampler.rng)

    # How the shadow's edge runs on the film.
    back = FilmMap.of(camera, aperture)
    x, y, depth = back.weights(si.p)
    active &= depth > 0
    depth = dr.select(active, depth, 1)
    at = dr.select(active, x / depth, -1), dr.select(active, y / depth, -1)
    active &= film.pixel_at(*at)[2]
    across = film_side.across(film, back.tangent(si.p, shadow.along))
    step = film_side.steps(film, across)
    seen = camera.sample_ray(t.Array2f(*at), aperture)
    way = film_side.lateral(back, step, depth)
    tilt = dr.dot(si.n, seen.d)
    active &= tilt != 0
    way = way - seen.d * (dr.dot(si.n, way) / dr.select(active, tilt, 1))
    reach = film_side.reach(si.p, si.p - back.base, back.base, back.du * depth, back.dv * depth)
    reach = dr.fmax(reach, shadow.reach)
    size = film_side.clear_of_rounding(way, shadow.plane, reach, film_side.SHADOW_CLEARANCE * t.epsilon)
    active &= size < 1
    hidden = t.Bool(True) if job.settings.hide_emitters else None
    first_hit = StructureTracing(job.traced).closest(seen, active, hidden)
    far = dr.dot(si.p - seen.o, seen.d)
    active &= first_hit.valid & (dr.abs(first_hit.t - far) < far * film_side.NEAR)
    dr.eval(at, step, size, across, active, first_hit)

    # The light of that same point of the light on either side.
    both = dr.arange(t.UInt, 2 * count)
    half, sign = both >> 1, dr.select((both & 1) == 0, t.Float(-1), 1)
    where, step_there = (t.Array2f(*(dr.gather(t.Float, v, half) for v in pair)) for pair in (at, step))
    where = where + step_there * (dr.gather(t.Float, size, half) * sign)
    lens = None if aperture is None else dr.gather(t.Array2f, aperture, half)
    light = _light_seen(job, casting.kind, where, lens, dr.gather(t.Array2f, shadow.u, half), twice(sampler, half),
                        dr.gather(t.Bool, active, half))  # fmt: skip
    dr.eval(light)
    own = dr.arange(t.UInt, count) * 2
    jump = dr.gather(t.Array3f, light, own) - dr.gather(t.Array3f, light, own + 1)
    per_sample = dr.opaque(t.Float, job.sampler.sample_count / total)
    scale = per_sample * casting.curves.share(shadow.index) / dr.select(active, shadow.chance, 1)

    def position() -> tuple[Any, Any]:
        p = structure.interact(camera.sample_ray(t.Array2f(*at), aperture), first_hit).p
        x, y, depth = FilmMap.of(camera, aperture).weights(shadow.moved(structure, p))
        depth = dr.select(active, depth, 1)
        return film_side.pixels(film, (x / depth, y / depth))

    return Crossings(film, at, jump, (across[0] * scale, across[1] * scale), active, position)


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
    return kind.light(si, u, scene.material(si, active), material_share(job), active)
