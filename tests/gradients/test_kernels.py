"""What runs for a backward pass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import gradient_scenes as scenes
import pytest

import raytrace2 as rt


@pytest.mark.parametrize("things", [{}, {"integrator": {"type": "direct"}}], ids=["path", "direct"])
@pytest.mark.parametrize("key", ["sensor.to_world", "sensor.x_fov", "ball.to_world", "floor.bsdf.reflectance.data"])
def test_one_kernel_goes_back(key: str, things: dict[str, Any]) -> None:
    """However many numbers there are gradients by: sums over all lanes must not each run the paths anew."""
    scene = scenes.load(**things)
    params = rt.traverse(scene)
    dr.enable_grad(params[key])
    params.update()
    # An operation runs backwards with the flags that it was made with.
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        # As many lanes as no buffer has entries.
        image = rt.render(scene, params, spp=37, size=(20, 18))
        dr.eval(image)
        dr.kernel_history_clear()
        dr.backward(dr.sum(dr.square(image), axis=None))
        dr.eval(dr.grad(params[key]))
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert sum(kernel["size"] == 37 * 20 * 18 for kernel in kernels) == 1
