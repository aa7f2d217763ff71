"""What sampling a material gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass
class BsdfSample:
    """A sampled direction, one lane a ray; all lanes of zero ``weight`` carry nothing on.

    ``wo`` Array3f, away from the surface, in the shading frame; ``weight`` Array3f, the material's value times the
    cosine over the density; ``pdf`` Float, per steradian, or the lobe's probability where ``delta``; ``eta`` Float, the
    index of refraction on the side of ``wo`` over that on the side of the ray (1 unless refracted); ``delta`` Bool, no
    other direction could have been met (reflection, refraction, null); ``null`` Bool, the ray goes straight on.
    """

    wo: Any
    weight: Any
    pdf: Any
    eta: Any
    delta: Any
    null: Any
