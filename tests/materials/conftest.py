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
    """Surface interactions of which only what materials read is given: (types, wi, uv)."""

    def make(t: Types, wi: Any, uv: Any = None) -> SurfaceInteraction:
        zero3 = t.Array3f(0)
        wi = wi if isinstance(wi, t.Array3f) else t.Array3f(np.asarray(wi, dtype=t.numpy))
        return SurfaceInteraction(
            valid=t.Bool(True), t=t.Float(1), p=zero3, n=zero3, sh_frame=Frame(zero3, zero3, zero3),
            uv=t.Array2f(0) if uv is None else t.Array2f(np.asarray(uv, dtype=t.numpy)), dp_du=zero3, dp_dv=zero3,
            prim_uv=t.Array2f(0), wi=wi, prim=t.UInt(0), surface=t.UInt(0), instance=t.UInt(0xFFFFFFFF),
        )  # fmt: skip

    return make
