"""Derivatives of aovs: what is at the first hit of each ray, met anew with derivatives attached.

Of where aovs jump, silhouettes and creases can be told (:mod:`raytrace2.boundary`), for ``shape_index`` too. Not told
are seams of uv, and edges between faces in one plane, where ``dp_du`` and ``dp_dv`` may jump though normals do not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr

from ...rays.differentials import Differentials
from ...rays.ray import Ray
from ...scene.description import Integrator
from ...scene.traced import TracedScene
from ..aov import CHANNELS, COUNTED, FOOTPRINTS, aov
from ..tracing import StructureTracing
from .memory import Player, Recorder
from .what import Replay


def aov_again(
    scene: TracedScene,
    settings: Integrator,
    ray: Ray,
    moving: Ray,
    offset_rays: tuple[Ray, Ray] | None,
    replay: Replay,
    differentials: Differentials,
    differential: Any,
    moving_differential: Any,
    random: Any,
    footprints: bool,
) -> list[Any]:
    """The values (Float) of every channel of ``settings.aovs`` with derivatives attached, and 0 for those that have
    none: by ``replay.values``, by ``moving`` and its differential, which are ``ray`` and ``differential`` with
    derivatives, and by ``offset_rays``. ``random`` is as for :func:`aov`. ``footprints``: those of footprints too."""
    still = COUNTED if footprints else (*COUNTED, *FOOTPRINTS)
    smooth = replace(settings, aovs=tuple(one for one in settings.aovs if one[1] not in still))
    with dr.suspend_grad(replay.values):
        recorder = Recorder(StructureTracing(scene), None, differentials)
        recorder.meet(scene.structure, ray, differential, recorder.closest(ray, True, None))
    player = Player(recorder.memory, replay.through)
    state = differential if replay.through is None else moving_differential
    found = iter(
        aov(scene, smooth, moving, offset_rays, differentials=player, differential=state, tracing=player, random=random)
        if smooth.aovs
        else []
    )
    zero = scene.types.Float(0)
    return [zero if kind in still else next(found) for _, kind in settings.aovs for _ in CHANNELS[kind]]
