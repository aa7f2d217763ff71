"""Mitsuba scenes (files, XML text, dicts) as :class:`SceneDescription`.

What cannot be rendered is refused, all of it in one :class:`SceneError` with file and line. Objects that nothing refers
to (an unused BSDF, a shape group without instances) shape no image and are not refused.
"""

from __future__ import annotations

from dataclasses import replace
from os import PathLike, fspath
from typing import Any

from ..errors import Location, Problem, SceneError
from . import parse
from .content_hash import content_hash
from .description import Camera, ConstantLight, EnvironmentLight, Integrator, Light, SceneDescription, Shape
from .mesh_buffers import live_mesh_shape
from .nodes import LiveObject, Node, ParsedScene
from .read_cameras import read_camera
from .read_integrators import read_integrator
from .read_lights import read_light
from .read_shapes import read_shape
from .reading import PropertyReader, Reading

# Properties of Mitsuba's scene that choose its acceleration structure and how it schedules
_MITSUBA_SCENE_OPTIONS = (
    "embree_use_robust_intersections", "kd_intersection_cost", "kd_traversal_cost", "kd_empty_space_bonus",
    "kd_stop_prims", "kd_max_depth", "kd_min_max_bins", "kd_clip", "kd_retract_bad_splits",
    "kd_exact_primitive_threshold", "allow_thread_reordering", "compact_acceleration_structures",
)  # fmt: skip


def describe_file(path: str | PathLike[str], **parameters: Any) -> SceneDescription:
    """Reads the Mitsuba XML file ``path``; ``parameters`` fill in its ``$name``.

    Settings of our own are ``<default name="raytrace2.KEY" value="..."/>`` in the file (Mitsuba ignores them), or
    parameters of that name; they come out as ``settings[KEY]``. :class:`SceneError` lists all that is wrong.
    """
    return _describe(parse.parse_file(fspath(path), parameters))


def describe_string(xml: str, **parameters: Any) -> SceneDescription:
    """Reads XML text; as :func:`describe_file`. Locations are ``<string>:line``."""
    return _describe(parse.parse_string(xml, parameters))


def describe_dict(scene: dict[str, Any], settings: dict[str, str] | None = None) -> SceneDescription:
    """Reads a dict as ``mi.load_dict`` takes it; it may hold live ``mi.Mesh`` and ``mi.Bitmap`` objects.

    ``settings`` are our own (a dict has no ``<default>``). Locations are ``<dict>[path of keys]``.
    """
    return _describe(parse.parse_dict(scene, settings))


def _describe(parsed: ParsedScene) -> SceneDescription:
    root = parsed.root
    if root.kind != "scene":
        problem = Problem(f"the root is a {root.kind}, not a scene", root.location, "wrap it into a <scene>")
        raise SceneError([problem])
    reading = Reading(parsed.resolve)
    shapes: list[Shape] = []
    lights: list[Light] = []
    cameras: list[Camera] = []
    integrators: list[Integrator] = []
    for _, node in root.children:
        counts = len(shapes), len(lights), len(cameras)
        match node.kind:
            case "shape" if node.plugin != "shapegroup":
                _append(shapes, read_shape(node, reading))
            case "emitter" if node.plugin != "area":
                _append(lights, read_light(node, reading))
                if sum(isinstance(light, ConstantLight | EnvironmentLight) for light in lights) > 1:
                    reading.refuse(node, "is a second environment", "a scene has at most one constant or envmap")
            case "sensor":
                _append(cameras, read_camera(node, reading))
            case "integrator":
                integrators.append(read_integrator(node, reading))
                if len(integrators) > 1:
                    reading.refuse(node, "is a second integrator", "a scene has one")
            case "scene":
                reading.refuse(node, "scenes do not nest", "use <include>")
            case _:
                pass  # reached through references only
        found: list[list[Any]] = [shapes, lights, cameras]
        for items, count in zip(found, counts, strict=True):
            for item in items[count:]:
                reading.results[id(node)] = item
    live = _scene_properties(root, shapes, reading)
    names = [(node.name, reading.results[id(node)]) for _, node in root.children if id(node) in reading.results]
    _unknown_plugins(root, parsed, reading, set())
    if reading.problems:
        raise SceneError(sorted(reading.problems, key=_place))
    description = SceneDescription(
        shapes=tuple(shapes),
        lights=tuple(lights),
        cameras=tuple(cameras),
        integrator=integrators[0] if integrators else Integrator(),
        source=parsed.source,
        settings=parsed.settings,
        names=(*names, *live),
    )
    return replace(description, hash=content_hash(description))


def _append(found: list[Any], item: Any) -> None:
    if item is not None:
        found.append(item)


def _scene_properties(root: Node, shapes: list[Shape], reading: Reading) -> list[tuple[str, Shape]]:
    """Live meshes join ``shapes``, and are returned by name."""
    first = len(shapes)
    properties = PropertyReader(root, reading)
    properties.ignore(*_MITSUBA_SCENE_OPTIONS, *(name for name, _ in root.children))
    for name, value in root.properties.items():
        if isinstance(value, LiveObject):
            properties.ignore(name)
            if hasattr(value.value, "faces_buffer"):
                _append(shapes, live_mesh_shape(value.value, reading, root, name))
            else:
                remedy = "only meshes may be live objects; write others as dicts"
                reading.refuse(root, f"the live object '{name}' ({type(value.value).__name__}) cannot be read", remedy)
    properties.finish()
    return [(shape.id, shape) for shape in shapes[first:]]


def _unknown_plugins(node: Node, parsed: ParsedScene, reading: Reading, seen: set[int]) -> None:
    """Names that Mitsuba does not know either are mistakes even in objects that nothing uses."""
    pending = [node]
    while pending:
        node = pending.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        pending.extend(child for _, child in node.children)
        refused = any(p.location == node.location and f"'{node.plugin}'" in p.message for p in reading.problems)
        if node.kind != "scene" and not refused and not parsed.is_plugin(node.plugin):
            reading.refuse(node, f"there is no such {node.kind}", "check its name")


def _place(problem: Problem) -> tuple[str, int]:
    location = problem.location or Location("")
    return (location.file, location.line or 0)
