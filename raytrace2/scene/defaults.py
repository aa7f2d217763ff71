"""The default of every property that is read, per plugin, as Mitsuba 3.9.1 has them; one table, tested against it.

A property that has no entry here and is not given must be written out (or its absence has a meaning of its own).
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

_FILM_OUTPUT = {"file_format": "openexr", "component_format": "float16"}
_SAMPLER = {"sample_count": 4, "seed": 0}
_MONTE_CARLO = {"max_depth": -1, "rr_depth": 5, "hide_emitters": False}
_PROJECTIVE = {"near_clip": 1e-2, "far_clip": 1e4}
_MESH = {"face_normals": False, "flip_normals": False}

_TABLE: dict[str, dict[str, Any]] = {
    "obj": {**_MESH, "flip_tex_coords": True},
    "ply": {**_MESH, "flip_tex_coords": False},
    "serialized": {**_MESH, "shape_index": 0},
    "rectangle": {**_MESH},
    "cube": {**_MESH},
    "sphere": {"center": (0.0, 0.0, 0.0), "radius": 1.0, "flip_normals": False},
    "disk": {"flip_normals": False},
    "cylinder": {"p0": (0.0, 0.0, 0.0), "p1": (0.0, 0.0, 1.0), "radius": 1.0, "flip_normals": False},
    "diffuse": {"reflectance": 0.5},
    "conductor": {"material": "none", "eta": 0.0, "k": 1.0, "specular_reflectance": 1.0},
    "roughconductor": {
        "material": "none", "eta": 0.0, "k": 1.0, "specular_reflectance": 1.0, "distribution": "beckmann",
        "alpha": 0.1, "sample_visible": True,
    },
    "bumpmap": {"scale": 1.0, "flip_invalid_normals": True, "use_shadowing_function": True},
    "normalmap": {"flip_invalid_normals": True, "use_shadowing_function": True},
    "dielectric": {
        "int_ior": "bk7", "ext_ior": "air", "specular_reflectance": 1.0, "specular_transmittance": 1.0,
    },
    "thindielectric": {
        "int_ior": "bk7", "ext_ior": "air", "specular_reflectance": 1.0, "specular_transmittance": 1.0,
    },
    "twosided": {"allow_transmission": False},
    "mask": {"opacity": 0.5},
    "bitmap": {
        "filter_type": "bilinear", "wrap_mode": "repeat", "raw": False, "format": "auto", "accel": True,
    },
    "checkerboard": {"color0": 0.4, "color1": 0.2},
    "mesh_attribute": {"scale": 1.0},
    "d65": {"scale": 1.0},
    "point": {"intensity": 1.0, "sampling_weight": 1.0},
    "spot": {"intensity": 1.0, "cutoff_angle": 20.0, "beam_width": 15.0, "sampling_weight": 1.0},
    "directional": {"irradiance": 1.0, "sampling_weight": 1.0},
    "constant": {"radiance": 1.0, "sampling_weight": 1.0},
    "area": {"radiance": 1.0, "sampling_weight": 1.0},
    "envmap": {"scale": 1.0, "mis_compensation": False, "sampling_weight": 1.0},
    "perspective": {
        **_PROJECTIVE, "fov_axis": "x", "focal_length": "50mm",
        "principal_point_offset_x": 0.0, "principal_point_offset_y": 0.0,
    },
    "thinlens": {**_PROJECTIVE, "fov_axis": "x", "focal_length": "50mm"},
    "orthographic": {**_PROJECTIVE},
    "hdrfilm": {
        "width": 768, "height": 576, "crop_offset_x": 0, "crop_offset_y": 0,
        "pixel_format": "rgb", "sample_border": False, **_FILM_OUTPUT,
    },
    "independent": {**_SAMPLER},
    "stratified": {**_SAMPLER, "jitter": True},
    "multijitter": {**_SAMPLER, "jitter": True},
    "ldsampler": {**_SAMPLER},
    "box": {},
    "tent": {"radius": 1.0},
    "gaussian": {"stddev": 0.5},
    "mitchell": {"B": 1.0 / 3.0, "C": 1.0 / 3.0},
    "catmullrom": {},
    "lanczos": {"lobes": 3},
    "path": {**_MONTE_CARLO},
    "direct": {"shading_samples": 1, "hide_emitters": False},
    "aov": {"hide_emitters": False},
}  # fmt: skip

DEFAULTS = MappingProxyType({plugin: MappingProxyType(properties) for plugin, properties in _TABLE.items()})

#: Textures of our own, which Mitsuba does not have.
OWN_TEXTURES = frozenset({"raytrace2_fbm"})

# Index of refraction at about 589 nm of what `int_ior` and `ext_ior` can name, as Mitsuba tabulates it.
IOR = MappingProxyType({
    "vacuum": 1.0, "helium": 1.000036, "hydrogen": 1.000132, "air": 1.000277, "carbon dioxide": 1.00045,
    "water": 1.3330, "acetone": 1.36, "ethanol": 1.361, "carbon tetrachloride": 1.461, "glycerol": 1.4729,
    "benzene": 1.501, "silicone oil": 1.52045, "bromine": 1.661, "water ice": 1.31, "fused quartz": 1.458,
    "pyrex": 1.470, "acrylic glass": 1.49, "polypropylene": 1.49, "bk7": 1.5046, "sodium chloride": 1.544,
    "amber": 1.55, "pet": 1.5750, "diamond": 2.419,
})  # fmt: skip
