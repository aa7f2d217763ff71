"""What is known about the point where a ray met a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .frame import Frame


@dataclass
class SurfaceInteraction:
    """The local geometry at a hit, in world coordinates unless said otherwise; the names are Mitsuba's.

    Fields (one lane a ray): ``valid`` Bool; ``t`` Float (inf on a miss); ``p`` Array3f; ``n`` the geometric normal;
    ``sh_frame`` the shading frame; ``uv`` Array2f; ``dp_du``, ``dp_dv`` Array3f; ``prim_uv`` Array2f barycentric
    coordinates of triangles (weights of vertices 1 and 2); ``wi`` the direction back along the ray *in the shading frame*;
    ``prim`` UInt index within the surface; ``surface`` UInt index of the surface in the scene; ``instance`` UInt
    index of the instance surface, or 0xFFFFFFFF.
    """

    valid: Any
    t: Any
    p: Any
    n: Any
    sh_frame: Frame
    uv: Any
    dp_du: Any
    dp_dv: Any
    prim_uv: Any
    wi: Any
    prim: Any
    surface: Any
    instance: Any

    def to_local(self, v: Any) -> Any:
        """The world vector ``v`` in the shading frame."""
        return self.sh_frame.to_local(v)

    def to_world(self, v: Any) -> Any:
        """The vector ``v`` of the shading frame in world coordinates."""
        return self.sh_frame.to_world(v)
