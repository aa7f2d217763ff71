"""A render as one operation of Dr.Jit's automatic differentiation, in reverse and in forward mode.

The image is rendered as ever. Its derivatives are those of another render, with samples of its own: their noise is
then independent of the image's, and an error that is squared has gradients without bias.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr

from .boundary.motion import Boundary
from .errors import SettingError
from .fixed_order import ordered
from .integrators.replay import LONGEST, Replay, aov_again, direct_again, path_backward, path_forward
from .job import Job
from .live import Slot, bound
from .parameters.coercion import converted
from .private_sums import private_sums
from .rays.differentials import Differentials, RayDifferential, make_differentials
from .rays.ray import Ray
from .rays.wavefront import Wavefront
from .scene.description import Integrator

#: Differentials whose footprints the formulas of ``analytic`` have the derivatives of.
_SAME_FOOTPRINTS = ("analytic", "autodiff", "autodiff2")


def differentiable(
    image: Any, job: Job, footprints: bool = True, visibility: bool | int = False, deterministic: bool = False
) -> Any:
    """``image`` as a function of all live values that carry derivatives, which are taken with the samples of ``job``:
    ``footprints``, through footprints too; ``visibility``, with moving edges, by as many points of them as it says
    (True: as there are samples). ``SettingError`` for what has no derivatives."""
    slots, values = job.moving()
    store = job.traced.store
    if not slots:
        # Of what this image does not depend on, such as another camera, the derivative is zero.
        unseen = [store.entries[place].value for place in store.with_derivatives()]
        return dr.custom(_Nothing, image, unseen) if unseen else image
    moves = any(slot.moves for slot in slots)
    through = _footprints(job) if moves and footprints else None
    boundary = Boundary(job, slots, 0 if visibility is True else visibility) if moves and visibility else None
    how = _How(job, slots, moves, footprints, through, boundary)
    if not deterministic:
        return dr.custom(_Render, values, image, how)
    places, present = store.with_derivatives(), {place: entry.value for place, entry in store.entries.items()}

    def rendered(moving: list[Any]) -> Any:
        now = present | dict(zip(places, moving, strict=True))
        made = [slot.made(lambda place: converted(now[place], job.traced.types)) for slot in slots]
        return dr.custom(_Render, made, image, how)

    return ordered(rendered, [present[place] for place in places], image)


def unlike(seed: Any) -> Any:
    """A seed for samples that have nothing to do with those of ``seed`` (an int or a UInt)."""
    found = seed * 0x9E3779B1 + 0x85EBCA77
    return found % 2**32 if isinstance(found, int) else found


class _How:
    """The samples by which to differentiate, what by, whether rays move with it, whether footprints do and what by,
    and the edges that move.

    No dataclass: Dr.Jit would take it for a PyTree, and give the operation a copy of everything below it.
    """

    def __init__(
        self, job: Job, slots: list[Slot], moves: bool, footprints: bool, through: Differentials | None,
        boundary: Boundary | None,
    ) -> None:  # fmt: skip
        self.job, self.slots, self.moves, self.boundary = job, slots, moves, boundary
        self.footprints, self.through = footprints, through
        #: The scene may change before derivatives are asked for.
        self.moment = job.traced.now()


class _Render(dr.CustomOp):
    def eval(self, values: list[Any], image: Any, how: _How) -> Any:
        self._values, self._how = values, how
        return type(image)(image)

    def forward(self) -> None:
        moving = _Moving.of(self._values, self._how, self.grad_in("values"))
        with self._how.job.traced.at(self._how.moment):
            self.set_grad_out(moving.image_tangent())

    def backward(self) -> None:
        moving = _Moving.of(self._values, self._how, None)
        with self._how.job.traced.at(self._how.moment):
            self.set_grad_in("values", moving.value_adjoints(self.grad_out()))

    def name(self) -> str:
        return "raytrace2.render"


class _Nothing(dr.CustomOp):
    """An image that depends on nothing that has derivatives."""

    def eval(self, image: Any, unseen: list[Any]) -> Any:
        return type(image)(image)

    def forward(self) -> None:
        pass

    def backward(self) -> None:
        pass

    def name(self) -> str:
        return "raytrace2.render"


@dataclass(frozen=True, eq=False)
class _Moving:
    """A job with copies of its values that carry derivatives."""

    job: Job
    slots: list[Slot]
    replay: Replay
    footprints: bool
    boundary: Boundary | None

    @staticmethod
    def of(values: list[Any], how: _How, tangents: list[Any] | None) -> _Moving:
        copies = [type(value)(dr.detach(value)) for value in values]
        dr.enable_grad(copies)
        if tangents is not None:
            dr.set_grad(copies, tangents)
        how.job.view.film.clear()
        replay = Replay(copies, how.moves, how.through, how.boundary is not None)
        return _Moving(how.job, how.slots, replay, how.footprints, how.boundary)

    def value_adjoints(self, image: Any) -> list[Any]:
        """The adjoint of each value, given that of the image."""
        film, job = self.job.view.film, self.job
        if film.filter.is_box:
            film.expect(job.sampler.sample_count)
        else:
            for wavefront in job.passes:
                film.add(wavefront, job.begin(wavefront)[0], [job.traced.types.Float(0)] * film.channels)
        adjoint = film.adjoint(image)
        with bound(self.slots, self.replay.values):
            for wavefront in job.passes:
                with private_sums(wavefront.size):
                    longer = self._pass_backward(wavefront, adjoint)
                    dr.eval([dr.grad(v) for v in self.replay.values], longer)
                _warn(longer)
            if self.boundary is not None:
                for crossings in self.boundary.crossings(self.replay.values):
                    crossings.backward(film, adjoint)
                    dr.eval([dr.grad(v) for v in self.replay.values])
        return [dr.grad(v) for v in self.replay.values]

    def image_tangent(self) -> Any:
        """How the image changes, for the tangents that the values have."""
        job, film = self.job, self.job.view.film
        with bound(self.slots, self.replay.values):
            for wavefront in job.passes:
                offset, change = self._pass_forward(wavefront)
                film.add(wavefront, offset, dr.detach(change))
            if self.boundary is not None:
                for crossings in self.boundary.crossings(self.replay.values):
                    crossings.forward(film)
        return film.develop()

    def _pass_backward(self, wavefront: Wavefront, adjoint: Any) -> Any:
        job, replay, radiance = self.job, self.replay, self.job.radiance
        view, t = job.view, job.traced.types
        with dr.suspend_grad(replay.values):
            offset, position, aperture = job.begin(wavefront)
            ray, differential = view.differentials.start(view.camera, position, aperture)
            random = job.texel_random(job.sampler)
            given = view.film.sample_adjoints(adjoint, wavefront, offset)
        longer, terms = None, []
        if radiance is not None and radiance.kind == "path":
            light, given = t.Array3f(*given[:3]), given[3:]
            following, longer = path_backward(
                job.traced, radiance, job.sampler, ray, light, replay, view.differentials, differential
            )
            if replay.moves:
                moving, moving_differential = self._start(position, aperture)
                # Those of the throughput, the origin of the way to the camera and its density go no further.
                parts = [moving.o, moving.d, *_parts(moving_differential)]
                terms = [dr.dot(a, x) for a, x in zip([*following[1:3], *following[5:]], parts, strict=True)]
        values = self._values(radiance, ray, differential, position, aperture, random)
        terms += [a * x for a, x in zip(given, values, strict=True)]
        total = _sum(terms) if terms else t.Float(0)
        if dr.grad_enabled(total):
            dr.backward_from(total)
        return longer

    def _pass_forward(self, wavefront: Wavefront) -> tuple[Any, list[Any]]:
        job, replay, radiance = self.job, self.replay, self.job.radiance
        view = job.view
        with dr.suspend_grad(replay.values):
            offset, position, aperture = job.begin(wavefront)
            ray, differential = view.differentials.start(view.camera, position, aperture)
            random = job.texel_random(job.sampler)
        change: list[Any] = []
        if radiance is not None and radiance.kind == "path":
            moving, moving_differential = self._start(position, aperture)
            tangents = _tangents([moving.o, moving.d, *_parts(moving_differential)])
            light = path_forward(
                job.traced, radiance, job.sampler, ray, tangents, replay, view.differentials, differential
            )
            change = list(light)
        return offset, change + _tangents(self._values(radiance, ray, differential, position, aperture, random))

    def _values(
        self, radiance: Integrator | None, ray: Ray, differential: Any, position: Any, aperture: Any, random: Any
    ) -> list[Any]:
        """The values of one sample a lane, with derivatives: the colour, unless paths are replayed, and aovs."""
        job, replay, differentials = self.job, self.replay, self.job.view.differentials
        found: list[Any] = []
        if job.settings.kind == "path":
            return found
        moving, moving_differential = self._start(position, aperture)
        if radiance is not None and radiance.kind == "direct":
            light = direct_again(
                job.traced, radiance, job.sampler, ray, moving, replay, differentials, differential,
                moving_differential,
            )  # fmt: skip
            found = list(light)
        if job.settings.kind == "aov":
            offsets = None if differential is not None else self._from_camera(job.offset_rays, position, aperture)
            found += aov_again(
                job.traced, job.settings, ray, moving, offsets, replay, differentials, differential,
                moving_differential, random, self.footprints,
            )  # fmt: skip
        return found

    def _start(self, position: Any, aperture: Any) -> tuple[Ray, RayDifferential | None]:
        """The camera's rays, with derivatives if the camera has them."""
        camera = self.job.view.camera
        if self.replay.through is None:
            return self._from_camera(camera.sample_ray, position, aperture), None
        ray, right, down = self._from_camera(camera.sample_ray_differential, position, aperture, self.job.view.step)
        return ray, RayDifferential.full(ray.o, *right, *down)

    def _from_camera(self, ask: Callable[..., Any], position: Any, *more: Any) -> Any:
        """What the camera answers to ``ask(position, *more)``."""
        slots = self.job.camera_slots
        first = dr.zeros(self.job.traced.types.UInt, dr.width(position))
        with bound(slots, [_gathered(slot.value, first) for slot in slots]):
            return ask(position, *more)


def _gathered(values: Any, index: Any) -> Any:
    """A PyTree of arrays of width 1, gathered by every lane: their adjoints are then added up in the kernel that makes
    them, which otherwise runs once for each number."""
    if isinstance(values, list):
        return [_gathered(value, index) for value in values]
    return dr.gather(type(values), values, index) if dr.grad_enabled(values) else values


def _footprints(job: Job) -> Differentials | None:
    """What tells the derivatives of footprints; None where there are no footprints."""
    name = job.filtering.differentials
    if name == "none":
        return None
    if name not in _SAME_FOOTPRINTS:
        raise SettingError(
            f"footprints by {name!r} differentials have no derivatives: choose {', '.join(_SAME_FOOTPRINTS)}, or "
            "footprint_gradients=False, which takes footprints as they are"
        )
    return make_differentials("analytic", job.view.step, job.view.spacing)


def _parts(differential: RayDifferential | None) -> list[Any]:
    if differential is None:
        return []
    return [differential.o_dx, differential.d_dx, differential.o_dy, differential.d_dy]


def _tangents(values: list[Any]) -> list[Any]:
    """How ``values`` change for the tangents that their inputs have."""
    ends = [-v for v in values]
    moving = [end for end in ends if dr.grad_enabled(end)]
    if moving:
        dr.forward_to(moving, flags=dr.ADFlag.ClearEdges | dr.ADFlag.ClearInterior)
    return [-dr.grad(end) for end in ends]


def _sum(values: list[Any]) -> Any:
    total = values[0]
    for value in values[1:]:
        total = total + value
    return total


def _warn(longer: Any) -> None:
    if longer is None or dr.flag(dr.JitFlag.FreezingScope):
        return
    count = int(longer[0])
    if count:
        message = (
            f"{count} paths were longer than {LONGEST} bounces, and the gradients leave out what lies beyond: give the "
            "integrator a max_depth"
        )
        warnings.warn(message, RuntimeWarning, stacklevel=2)
