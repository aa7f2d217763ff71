"""Buffers that kernels read have the derivatives of what they follow from."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import parameter_scenes as scenes
import pytest

import raytrace2 as rt
from raytrace2.parameters.cameras import live_camera
from raytrace2.textures.filter_settings import FilterSettings
from raytrace2.types import types

T64 = types("float64")


def flat(value: Any) -> Any:
    """All numbers of buffers, in one row."""
    parts = value if isinstance(value, list | tuple) else [value]
    found = []
    for part in parts:
        if isinstance(part, list | tuple):
            found.append(flat(part))
        elif dr.is_float_v(part):
            found.append(T64.Float(dr.ravel(part)))
    return dr.concat(found) if found else T64.Float(0)


def buffers(scene: rt.Scene, filter: FilterSettings | None) -> Any:
    traced = scene.traced("brute_force", "float64", filter)
    values = []
    for slot, value in zip(traced.slots, traced.live_values(), strict=True):
        # How often samples are drawn has no derivatives; of an environment's texels it is the fourth word.
        if slot.attribute == "texels":
            value = dr.select(dr.arange(T64.UInt, dr.width(value)) % 4 == 3, 0, value)
        if slot.attribute not in ("chances", "areas", "rows", "columns"):
            values.append(value)
    for sensor, settings in enumerate(scene.cameras):
        slots = live_camera(scene, sensor, settings, T64)[1]
        values += [slot.made(scene.store.values(T64)) for slot in slots]
    return flat(values)


def check(scene: dict[str, Any], key: str, filter: FilterSettings | None = None) -> None:
    loaded = rt.load_dict(scene)
    params = rt.traverse(loaded, "float64")
    value = params[key]
    dr.enable_grad(value)
    params.update()
    found = buffers(loaded, filter)
    rng = np.random.default_rng(3)
    weights = T64.Float(rng.normal(size=dr.width(found)))
    dr.backward(dr.sum(found * weights))
    gradient = dr.grad(params[key]).numpy()
    gradient = np.array([[g] for g in gradient.ravel()]).reshape(gradient.shape)
    assert np.isfinite(gradient).all()
    before = params[key].numpy()
    direction = rng.normal(size=before.shape)
    if before.ndim == 3 and before.shape[:2] in ((4, 4), (3, 3)) and "data" not in key:
        direction[-1] = 0
    step = 1e-6
    ends = []
    for sign in (1, -1):
        moved = before + sign * step * direction
        params[key] = moved[..., 0] if "to_" in key else moved
        params.update()
        ends.append(buffers(loaded, filter).numpy() @ weights.numpy())
    numeric = (ends[0] - ends[1]) / (2 * step)
    analytic = float((gradient * direction).sum())
    assert analytic == pytest.approx(numeric, rel=2e-6, abs=2e-6 * (1 + np.abs(weights.numpy()).max()))
    assert abs(analytic) > 1e-9


def keys_of(scene: dict[str, Any]) -> list[str]:
    return list(rt.traverse(rt.load_dict(scene)).keys())


@pytest.mark.parametrize("key", keys_of(scenes.everything()))
def test_buffers_have_the_derivatives_of_what_they_follow_from(key: str) -> None:
    check(scenes.everything(), key)
