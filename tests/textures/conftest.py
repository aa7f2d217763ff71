from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from raytrace2.surfaces.frame import Frame
from raytrace2.surfaces.interaction import SurfaceInteraction
from raytrace2.types import Types


@pytest.fixture
def interaction() -> Callable[..., SurfaceInteraction]:
    """Surface interactions of which only what textures read is given: (types, uv, prim=0, prim_uv=0, surface=0)."""

    def make(t: Types, uv: Any, *, prim: Any = 0, prim_uv: Any = None, surface: Any = 0) -> SurfaceInteraction:
        zero3 = t.Array3f(0)
        return SurfaceInteraction(
            valid=t.Bool(True), t=t.Float(1), p=zero3, n=zero3, sh_frame=Frame(zero3, zero3, zero3),
            uv=t.Array2f(np.asarray(uv, dtype=t.numpy)), dp_du=zero3, dp_dv=zero3,
            prim_uv=t.Array2f(0) if prim_uv is None else t.Array2f(np.asarray(prim_uv, dtype=t.numpy)),
            wi=t.Array3f(0, 0, 1), prim=t.UInt(prim), surface=t.UInt(surface), instance=t.UInt(0xFFFFFFFF),
        )  # fmt: skip

    return make
