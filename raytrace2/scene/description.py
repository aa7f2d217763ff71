"""What a scene says, as frozen dataclasses that know nothing of Mitsuba or Dr.Jit.

The reader (:mod:`raytrace2.scene.reader`) makes these from Mitsuba's XML or dicts with every default filled in, and
:mod:`raytrace2.scene.scene` turns them into device buffers. Arrays are NumPy, read-only; transforms are float64 4x4
matrices that map local to world coordinates; colours are linear Rec. 709 RGB triples.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from ..errors import Location

RGB: TypeAlias = tuple[float, float, float]


def _identity(n: int) -> np.ndarray:
    matrix = np.eye(n)
    matrix.setflags(write=False)
    return matrix


# --- textures -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ConstantTexture:
    """``grey``: it was written as one number, and is one parameter."""

    value: RGB
    grey: bool = False


@dataclass(frozen=True, eq=False)
class BitmapTexture:
    """``pixels`` is (height, width, channels) with 1 or 3 channels, as the file stores them: uint8, float16 or float32.

    uint8 pixels are sRGB-encoded unless ``raw``; floating-point ones are linear. ``to_uv`` maps the surface's uv to the
    texture's. Row 0 is the top of the image and lies at v = 0, as in Mitsuba.
    """

    pixels: np.ndarray
    filename: str = ""
    filter_type: Literal["nearest", "bilinear"] = "bilinear"
    wrap_mode: Literal["repeat", "mirror", "clamp"] = "repeat"
    raw: bool = False
    to_uv: np.ndarray = field(default_factory=lambda: _identity(3))


@dataclass(frozen=True, eq=False)
class CheckerboardTexture:
    color0: Texture
    color1: Texture
    to_uv: np.ndarray = field(default_factory=lambda: _identity(3))


@dataclass(frozen=True, eq=False)
class MeshAttributeTexture:
    """Interpolates the mesh attribute ``name`` (``vertex_...`` or ``face_...``), times ``scale``."""

    name: str
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class FbmTexture:
    """Fractional Brownian motion, from ``color0`` (a sum of -1) to ``color1`` (1): the mean of ``octaves`` of Perlin's
    gradient noise, each ``lacunarity`` times as fine as the one before and weighted ``persistence`` times as much.

    A cell of the first one's lattice is a unit of the transformed uv; ``seed`` shuffles the lattice.
    """

    color0: RGB = (0.0, 0.0, 0.0)
    color1: RGB = (1.0, 1.0, 1.0)
    octaves: int = 8
    persistence: float = 0.5
    lacunarity: float = 2.0
    seed: int = 0
    to_uv: np.ndarray = field(default_factory=lambda: _identity(3))


Texture: TypeAlias = ConstantTexture | BitmapTexture | CheckerboardTexture | MeshAttributeTexture | FbmTexture

# --- materials ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DiffuseBsdf:
    reflectance: Texture = ConstantTexture((0.5, 0.5, 0.5))


@dataclass(frozen=True, eq=False)
class ConductorBsdf:
    """A smooth conductor with complex index of refraction ``eta + i k`` per channel (0 and 1: a perfect mirror)."""

    eta: Texture = ConstantTexture((0.0, 0.0, 0.0))
    k: Texture = ConstantTexture((1.0, 1.0, 1.0))
    specular_reflectance: Texture = ConstantTexture((1.0, 1.0, 1.0))


@dataclass(frozen=True, eq=False)
class RoughConductorBsdf:
    """Microfacets of a conductor; ``alpha_u`` and ``alpha_v`` are the roughness along the tangent and across it.

    ``sample_visible``: directions are sampled by visible normals, not by all of them.
    """

    distribution: Literal["beckmann", "ggx"] = "beckmann"
    alpha_u: Texture = ConstantTexture((0.1, 0.1, 0.1))
    alpha_v: Texture = ConstantTexture((0.1, 0.1, 0.1))
    sample_visible: bool = True
    eta: Texture = ConstantTexture((0.0, 0.0, 0.0))
    k: Texture = ConstantTexture((1.0, 1.0, 1.0))
    specular_reflectance: Texture = ConstantTexture((1.0, 1.0, 1.0))


@dataclass(frozen=True, eq=False)
class DielectricBsdf:
    """A smooth interface; the interior lies on the side away from the surface normal."""

    int_ior: float = 1.5046
    ext_ior: float = 1.000277
    specular_reflectance: Texture = ConstantTexture((1.0, 1.0, 1.0))
    specular_transmittance: Texture = ConstantTexture((1.0, 1.0, 1.0))


@dataclass(frozen=True, eq=False)
class ThinDielectricBsdf:
    int_ior: float = 1.5046
    ext_ior: float = 1.000277
    specular_reflectance: Texture = ConstantTexture((1.0, 1.0, 1.0))
    specular_transmittance: Texture = ConstantTexture((1.0, 1.0, 1.0))


@dataclass(frozen=True, eq=False)
class TwoSidedBsdf:
    front: Bsdf
    back: Bsdf


@dataclass(frozen=True, eq=False)
class MaskBsdf:
    nested: Bsdf
    opacity: Texture = ConstantTexture((0.5, 0.5, 0.5))


@dataclass(frozen=True, eq=False)
class BumpMapBsdf:
    """``nested`` in the shading frame of a surface displaced by ``texture`` (one channel) times ``scale``.

    ``flip_invalid_normals``: normals that face away from the viewer are turned about the shading normal.
    ``use_shadowing_function``: light at grazing angles is attenuated (Estevez et al. 2019).
    """

    nested: Bsdf
    texture: Texture
    scale: float = 1.0
    flip_invalid_normals: bool = True
    use_shadowing_function: bool = True


@dataclass(frozen=True, eq=False)
class NormalMapBsdf:
    """``nested`` in the shading frame whose normal is ``2 normalmap - 1``, in the frame of the surface; flags as for
    :class:`BumpMapBsdf`."""

    nested: Bsdf
    normalmap: Texture
    flip_invalid_normals: bool = True
    use_shadowing_function: bool = True


Bsdf: TypeAlias = (
    DiffuseBsdf
    | ConductorBsdf
    | RoughConductorBsdf
    | DielectricBsdf
    | ThinDielectricBsdf
    | TwoSidedBsdf
    | MaskBsdf
    | BumpMapBsdf
    | NormalMapBsdf
)

# --- lights ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PointLight:
    """``grey``, here and in other lights: its colour was written as one number, and is one parameter."""

    position: tuple[float, float, float]
    intensity: RGB = (1.0, 1.0, 1.0)
    grey: bool = False


@dataclass(frozen=True, eq=False)
class SpotLight:
    """Shines along local +z; full inside ``beam_width``, none outside ``cutoff_angle`` (degrees from the axis)."""

    to_world: np.ndarray
    intensity: RGB = (1.0, 1.0, 1.0)
    cutoff_angle: float = 20.0
    beam_width: float = 15.0
    texture: Texture | None = None
    grey: bool = False


@dataclass(frozen=True, eq=False)
class DirectionalLight:
    direction: tuple[float, float, float]
    irradiance: RGB = (1.0, 1.0, 1.0)
    grey: bool = False


@dataclass(frozen=True, eq=False)
class ConstantLight:
    radiance: RGB = (1.0, 1.0, 1.0)
    grey: bool = False


@dataclass(frozen=True, eq=False)
class EnvironmentLight:
    """``pixels``: (height, width, 3) float32, linear, latitude-longitude with Mitsuba's orientation."""

    pixels: np.ndarray
    to_world: np.ndarray = field(default_factory=lambda: _identity(4))
    scale: float = 1.0
    filename: str = ""


@dataclass(frozen=True, eq=False)
class AreaLight:
    """Belongs to a shape: emits on the side that the shape's geometric normal points to."""

    radiance: Texture = ConstantTexture((1.0, 1.0, 1.0))


Light: TypeAlias = PointLight | SpotLight | DirectionalLight | ConstantLight | EnvironmentLight

# --- shapes ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class Shape:
    """What every shape has. ``id`` is the name in the file or a generated one; ``location`` is where it was written."""

    id: str
    location: Location | None = None
    bsdf: Bsdf = DiffuseBsdf()
    emitter: AreaLight | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshShape(Shape):
    """A triangle mesh in world coordinates (``to_world`` is applied).

    ``vertices`` (n, 3) float64, ``faces`` (m, 3) uint32, ``normals`` (n, 3) unit or None (then flat shading), ``uv``
    (n, 2) or None; ``attributes`` maps ``vertex_...``/``face_...`` names to (n or m, channels) arrays. Mitsuba's
    ``flip_normals`` is applied where ``flipped``: it swaps the last two vertices of each face and negates ``normals``.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    filename: str = ""
    flipped: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class SphereShape(Shape):
    """The unit sphere under ``to_world`` (rotation, uniform scale and translation; center and radius are folded in).

    The normal points outward, or inward with ``flip_normals``, which already counts a ``to_world`` that mirrors.
    """

    to_world: np.ndarray
    flip_normals: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class RectangleShape(Shape):
    """[-1, 1]^2 in the local xy plane; the normal is +z (under the inverse transpose), or its opposite."""

    to_world: np.ndarray
    flip_normals: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class DiskShape(Shape):
    """The unit disk in the local xy plane; the normal is +z (under the inverse transpose), or its opposite."""

    to_world: np.ndarray
    flip_normals: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class CylinderShape(Shape):
    """The open cylinder of unit radius from local z = 0 to z = 1 (p0, p1 and radius are folded into ``to_world``).

    The normal points away from the axis, or towards it with ``flip_normals``, also where ``to_world`` mirrors.
    """

    to_world: np.ndarray
    flip_normals: bool = False


@dataclass(frozen=True, eq=False)
class ShapeGroup:
    """Shapes in a coordinate system of their own, met only through instances."""

    id: str
    shapes: tuple[Shape, ...]
    location: Location | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class InstanceShape(Shape):
    """A copy of ``group`` under ``to_world``; its material is that of the shapes in the group."""

    group: ShapeGroup
    to_world: np.ndarray


# --- camera, film, sampler, integrator ------------------------------------------------------------------------------


@dataclass(frozen=True)
class ReconstructionFilter:
    """``name`` and the parameters that it has: ``radius`` (box, tent), ``stddev`` (gaussian), ``B`` and ``C``
    (mitchell), ``lobes`` (lanczos)."""

    name: Literal["box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos"] = "gaussian"
    radius: float | None = None
    stddev: float = 0.5
    B: float = 1.0 / 3.0
    C: float = 1.0 / 3.0
    lobes: int = 3


@dataclass(frozen=True)
class Film:
    """The image is ``width`` x ``height``, of which the crop window is rendered. ``pixel_format``: rgb or luminance."""

    width: int = 768
    height: int = 576
    crop_offset_x: int = 0
    crop_offset_y: int = 0
    crop_width: int = 768
    crop_height: int = 576
    rfilter: ReconstructionFilter = ReconstructionFilter()
    pixel_format: str = "rgb"
    sample_border: bool = False


@dataclass(frozen=True)
class Sampler:
    kind: Literal["independent", "stratified", "ldsampler", "multijitter"] = "independent"
    sample_count: int = 4
    seed: int = 0
    jitter: bool = True


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """What every camera has. ``to_world`` maps camera space (z forward, y up, x *left*) to the world."""

    to_world: np.ndarray
    near_clip: float = 1e-2
    far_clip: float = 1e4
    film: Film = Film()
    sampler: Sampler = Sampler()
    id: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class PerspectiveCamera(Camera):
    """``x_fov``: full horizontal field of view in degrees over the whole (uncropped) image; ``fov_axis`` the axis
    along which it
    was given, whose field of view stays when the film gets another shape."""

    x_fov: float
    fov_axis: str = "x"
    principal_point_offset_x: float = 0.0
    principal_point_offset_y: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class ThinLensCamera(PerspectiveCamera):
    aperture_radius: float
    focus_distance: float = 1.0


@dataclass(frozen=True, eq=False, kw_only=True)
class OrthographicCamera(Camera):
    """Sees [-1, 1] in local x (and as much of y as the aspect ratio gives); scale ``to_world`` to see more."""


@dataclass(frozen=True)
class Integrator:
    """``max_depth`` counts as in Mitsuba (-1: no bound; 1: emitters only; 2: direct light). ``aovs``: (name, kind)
    pairs for ``kind="aov"``, whose ``nested`` integrator gives the image that they follow."""

    kind: Literal["aov", "direct", "path"] = "path"
    max_depth: int = -1
    rr_depth: int = 5
    hide_emitters: bool = False
    emitter_samples: int = 1
    bsdf_samples: int = 1
    aovs: tuple[tuple[str, str], ...] = ()
    nested: Integrator | None = None


@dataclass(frozen=True, eq=False)
class SceneDescription:
    """A whole scene. ``source`` is the file it came from (or None) and ``hash`` a digest of everything that shapes the
    image: the text of all its files with parameters filled in, and the bytes of its meshes and textures. ``names`` are
    those of what stands directly in the scene, unused materials left out, in the order of the file."""

    shapes: tuple[Shape, ...]
    lights: tuple[Light, ...]
    cameras: tuple[Camera, ...]
    integrator: Integrator = Integrator()
    source: str | None = None
    hash: str = ""
    settings: dict[str, str] = field(default_factory=dict)
    names: tuple[tuple[str, Any], ...] = ()
