"""A differentiable, just-in-time-compiled ray tracer for the study of rendering."""

from __future__ import annotations

from ._llvm import settle as _settle_libllvm

_settle_libllvm()  # before anything imports drjit, which binds a libLLVM for good

from . import accel  # noqa: E402
from .compare import compare  # noqa: E402
from .errors import EnvironmentProblem, FileError, GeometryError, RayTraceError, SceneError, SettingError  # noqa: E402
from .load import load_dict, load_file, load_string  # noqa: E402
from .notebook import show_images_in_notebooks as _show_images_in_notebooks  # noqa: E402
from .parameters.scene_parameters import SceneParameters, traverse  # noqa: E402
from .rays.ray import Ray  # noqa: E402
from .reference.comparison import Comparison  # noqa: E402
from .render import RenderInterrupted, render  # noqa: E402
from .scene import procedural as scenes  # noqa: E402
from .scene.scene import Scene  # noqa: E402
from .surfaces.hit import Hit  # noqa: E402
from .surfaces.instance import Instance  # noqa: E402
from .surfaces.interaction import SurfaceInteraction  # noqa: E402
from .surfaces.mesh import TriangleMesh  # noqa: E402
from .surfaces.quadrics import Cylinder, Disk, Rectangle, Sphere  # noqa: E402
from .surfaces.surface import Surface  # noqa: E402
from .textures.filter_settings import filter_names  # noqa: E402
from .textures.laplacian_pyramid import LaplacianPyramid  # noqa: E402
from .textures.total_variation import total_variation  # noqa: E402

__all__ = [
    "Comparison",
    "Cylinder",
    "Disk",
    "EnvironmentProblem",
    "FileError",
    "GeometryError",
    "Hit",
    "Instance",
    "LaplacianPyramid",
    "Ray",
    "RayTraceError",
    "Rectangle",
    "RenderInterrupted",
    "Scene",
    "SceneError",
    "SceneParameters",
    "SettingError",
    "Sphere",
    "Surface",
    "SurfaceInteraction",
    "TriangleMesh",
    "accel",
    "compare",
    "filter_names",
    "load_dict",
    "load_file",
    "load_string",
    "render",
    "scenes",
    "total_variation",
    "traverse",
]

_show_images_in_notebooks()
