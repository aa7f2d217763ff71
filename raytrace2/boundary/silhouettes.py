"""Where surfaces end as the camera sees them."""

from __future__ import annotations

from typing import Any

import drjit as dr

from ..job import Job
from ..rays.film_map import FilmMap
from ..rays.ray import Ray
from ..types import types as make_types
from . import film_side
from .choose import Choice
from .crossings import Crossings, random_numbers, twice
from .curves import Curves
from .round_curves import Eye


def view_choice(job: Job, curves: Curves) -> Choice:
    """Curves by about how long they are on the film; those beside it have no chance."""
    camera, t = job.view.camera, job.traced.types
    view = FilmMap.of(camera)
    eye = Eye(view.eye, view.parallel)
    index = dr.arange(t.UInt, curves.count)
    points = [curves.at(index, t.Float(s), eye) for s in (0, 0.5, 1)]
    weight = curves.lengths()
    if not view.parallel:
        weight = weight / dr.norm(points[1].x - view.eye)
    if not camera.needs_aperture_sample:
        weight = weight * points[1].bend
        film = job.view.film
        margin = film.border + 1
        low = -margin / film.width, -margin / film.height
        ends = [view.weights(points[k].x) for k in (0, 2)]
        beside = t.Bool(False)
        for axis in (0, 1):
            beside |= dr.all([end[axis] < low[axis] * end[2] for end in ends])
            beside |= dr.all([end[axis] > (1 - low[axis]) * end[2] for end in ends])
        if not view.parallel:
            beside |= dr.all([end[2] < 0 for end in ends])
        weight = dr.select(curves.straight(index) & beside, 0, weight)
    return Choice(weight, t)


def silhouettes(job: Job, curves: Curves, choice: Choice, seed: Any, count: int, first: int, total: int) -> Crossings:
    """The samples ``first`` to ``first + count`` of ``total``, drawn from ``seed``."""
    view, t = job.view, job.traced.types
    camera, film = view.camera, view.film
    sampler = random_numbers(job, seed, count, first)
    lane = dr.arange(t.UInt, count) + dr.opaque(t.UInt, first)
    wide = make_types("float64").Float
    place = (wide(lane) + wide(sampler.next_1d())) * dr.opaque(wide, 1 / total)
    index, chance, s = choice.draw(place)
    aperture = sampler.next_2d() if camera.needs_aperture_sample else None
    dr.eval(index, chance, s, aperture, sampler.rng)

    back = FilmMap.of(camera, aperture)
    eye = Eye(back.eye, back.parallel)
    point = curves.at(index, s, eye)
    u, v, depth = back.weights(point.x)
    active = (chance > 0) & (point.bend > 0) & (depth > 0)
    depth = dr.select(active, depth, 1)
    at = dr.select(active, u / depth, -1), dr.select(active, v / depth, -1)
    active &= film.pixel_at(*at)[2]
    across = film_side.across(film, back.tangent(point.x, point.along))
    step = film_side.steps(film, across)
    plane = dr.cross(eye.way_from(point.x), point.along)
    way = film_side.lateral(back, step, depth)
    reach = film_side.reach(point.x, point.x - back.base, back.base, back.du * depth, back.dv * depth)
    size = film_side.clear_of_rounding(way, plane, reach, film_side.CLEARANCE * t.epsilon)
    active &= dr.isfinite(size)
    ray = camera.sample_ray(t.Array2f(*at), aperture)
    far = dr.dot(point.x - ray.o, ray.d) * (1 - film_side.NEAR)
    if not job.traced.materials.has_null:
        active &= ~job.traced.structure.occluded(Ray.of(ray.o, ray.d, 0, far), active)
    dr.eval(at, step, size, across, active)

    # Both sides draw the same numbers.
    both = dr.arange(t.UInt, 2 * count)
    half, sign = both >> 1, dr.select((both & 1) == 0, t.Float(-1), 1)
    where, step_there = (t.Array2f(*(dr.gather(t.Float, x, half) for x in pair)) for pair in (at, step))
    where = where + step_there * (dr.gather(t.Float, size, half) * sign)
    lens = None if aperture is None else dr.gather(t.Array2f, aperture, half)
    values = job.values(twice(sampler, half), where, lens, dr.gather(t.Bool, active, half))
    dr.eval(values)
    own = dr.arange(t.UInt, count) * 2
    jump = [
        dr.gather(t.Float, value, own) - dr.gather(t.Float, value, own + 1) if ends else t.Float(0)
        for value, ends in zip(values, job.ends_at_edges, strict=True)
    ]
    per_sample = dr.opaque(t.Float, job.sampler.sample_count / total)
    scale = per_sample * curves.share(index) / dr.select(active, chance, 1)

    def position() -> tuple[Any, Any]:
        moving = FilmMap.of(camera, aperture)
        x = curves.at(index, s, Eye(moving.eye, moving.parallel)).x
        u, v, depth = moving.weights(x)
        depth = dr.select(active, depth, 1)
        return film_side.pixels(film, (u / depth, v / depth))

    return Crossings(film, at, jump, (across[0] * scale, across[1] * scale), active, position)
