"""Orthonormal frames, and how a vector of any direction is completed to one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr


@dataclass
class Frame:
    """A right-handed orthonormal frame ``(s, t, n)``, each an Array3f in world coordinates."""

    s: Any
    t: Any
    n: Any

    def to_local(self, v: Any) -> Any:
        """Components of the world vector ``v`` along ``s``, ``t`` and ``n``."""
        return type(self.n)(dr.dot(v, self.s), dr.dot(v, self.t), dr.dot(v, self.n))

    def to_world(self, v: Any) -> Any:
        """The world vector whose components along ``s``, ``t`` and ``n`` are ``v``."""
        return self.s * v.x + self.t * v.y + self.n * v.z


def coordinate_system(n: Any) -> tuple[Any, Any]:
    """Two unit vectors that complete the unit vector ``n`` to a right-handed frame (Duff et al. 2017, JCGT 6(1))."""
    sign = dr.copysign(type(n.z)(1), n.z)
    a = -dr.rcp(sign + n.z)
    b = n.x * n.y * a
    return (
        type(n)(1 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        type(n)(b, sign + n.y * n.y * a, -n.y),
    )
