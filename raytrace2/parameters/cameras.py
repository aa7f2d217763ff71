"""Cameras whose transforms and fields of view may change."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from ..live import Slot
from ..rays.camera import Camera, make_camera
from ..rays.live_camera import camera_slots
from ..scene import description
from ..scene.scene import Scene
from ..types import Types


def live_camera(
    scene: Scene, sensor: int, settings: description.Camera, types: Types
) -> tuple[Camera, tuple[Slot, ...]]:
    """The camera ``sensor`` of ``scene`` as it is now, and where it holds live values.

    ``settings`` is its description, perhaps with another film. What kernels shall read is
    ``[slot.made(scene.store.values(types)) for slot in slots]``, functions of the parameters with derivatives.
    """
    camera = make_camera(settings, types)
    original = scene.description.cameras[sensor]
    scale = 1.0
    if isinstance(settings, description.PerspectiveCamera):
        now: Any = scene.store.current(original)
        scale = math.tan(math.radians(settings.x_fov) / 2) / math.tan(math.radians(now.x_fov) / 2)
    slots = tuple(camera_slots(camera, settings, original, scene.store.live(), scale))
    if dr.flag(dr.JitFlag.FreezingScope):
        # The description is of some time before.
        for slot in slots:
            slot.assign(dr.detach(slot.made(scene.store.values(types))))
    return camera, slots
