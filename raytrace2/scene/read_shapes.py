"""Shape nodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from .description import (
    AreaLight,
    Bsdf,
    ConstantTexture,
    CylinderShape,
    DiffuseBsdf,
    DiskShape,
    InstanceShape,
    RectangleShape,
    Shape,
    ShapeGroup,
    SphereShape,
)
from .mesh_buffers import cube_mesh, load_mesh, mesh_shape
from .nodes import Node
from .read_bsdfs import read_bsdf
from .read_lights import frozen, read_area_light
from .reading import PropertyReader, Reading
from .transforms import (
    column_lengths_differ,
    frame_towards,
    is_sheared,
    reverses_orientation,
    scaling,
    translation,
)

_MESH_FILES = ("obj", "ply", "serialized")


def read_shape(node: Node, reading: Reading) -> Shape | None:
    """The shape ``node``; None (and a problem) if it is not supported or its file cannot be read."""
    if node.plugin == "instance":
        return _instance(PropertyReader(node, reading))
    reader = _READERS.get(node.plugin)
    if reader is None:
        reading.unsupported(node, [*_READERS, "instance", "shapegroup"])
        return None
    properties = PropertyReader(node, reading)
    bsdf, emitter = _surface(properties)
    # A weight for the derivatives of silhouettes: no part of the image
    properties.ignore("silhouette_sampling_weight")
    common = {"id": node.id, "location": node.location, "bsdf": bsdf, "emitter": emitter}
    return reader(properties, common)


def _surface(properties: PropertyReader) -> tuple[Bsdf, AreaLight | None]:
    bsdf_node = properties.only_child("bsdf")
    emitter_node = properties.only_child("emitter")
    emitter = read_area_light(emitter_node, properties.reading) if emitter_node else None
    if bsdf_node is not None:
        return read_bsdf(bsdf_node, properties.reading), emitter
    # Mitsuba's default material is black on what emits
    grey = 0.0 if emitter_node else 0.5
    return DiffuseBsdf(ConstantTexture((grey, grey, grey), grey=True)), emitter


def _mesh_file(properties: PropertyReader, common: dict[str, Any]) -> Shape | None:
    node, reading = properties.node, properties.reading
    matrix = properties.transform()
    filename = properties.string("filename")
    face_normals = properties.boolean("face_normals")
    flip_normals = properties.boolean("flip_normals")
    options: dict[str, Any] = {}
    if node.plugin == "serialized":
        options["shape_index"] = properties.integer("shape_index", least=0)
    else:
        options["flip_tex_coords"] = properties.boolean("flip_tex_coords")
    properties.finish()
    path = reading.file(node, filename)
    mesh = reading.attempt(node, lambda: load_mesh(reading, path, node.plugin, **options)) if path else None
    if mesh is None:
        return None
    return mesh_shape(mesh, matrix, face_normals, flip_normals, reading, node, {**common, "filename": filename})


def _cube(properties: PropertyReader, common: dict[str, Any]) -> Shape | None:
    matrix = properties.transform()
    face_normals = properties.boolean("face_normals")
    flip_normals = properties.boolean("flip_normals")
    properties.finish()
    return mesh_shape(cube_mesh(), matrix, face_normals, flip_normals, properties.reading, properties.node, common)


def _rectangle(properties: PropertyReader, common: dict[str, Any]) -> Shape:
    properties.boolean("face_normals")
    shape = RectangleShape(
        to_world=frozen(properties.transform()), flip_normals=properties.boolean("flip_normals"), **common
    )
    properties.finish()
    return shape


def _disk(properties: PropertyReader, common: dict[str, Any]) -> Shape:
    shape = DiskShape(
        to_world=frozen(properties.transform()), flip_normals=properties.boolean("flip_normals"), **common
    )
    properties.finish()
    return shape


def _sphere(properties: PropertyReader, common: dict[str, Any]) -> Shape:
    center = translation(properties.vector("center"))
    radius = properties.number("radius", above=0.0)
    matrix = properties.transform() @ center @ scaling((radius, radius, radius))
    flip = properties.boolean("flip_normals")
    properties.finish()
    if column_lengths_differ(matrix, (0, 1, 2)) or is_sheared(matrix):
        remedy = "use a uniform scale, or a mesh"
        properties.reading.refuse(properties.node, "'to_world' scales a sphere differently along its axes", remedy)
    return SphereShape(to_world=frozen(matrix), flip_normals=flip != reverses_orientation(matrix), **common)


def _cylinder(properties: PropertyReader, common: dict[str, Any]) -> Shape:
    p0, p1 = properties.vector("p0"), properties.vector("p1")
    radius = properties.number("radius", above=0.0)
    length = float(np.linalg.norm(p1 - p0))
    matrix = properties.transform()
    flip = properties.boolean("flip_normals")
    properties.finish()
    if not 0.0 < length < np.inf:
        properties.reading.refuse(properties.node, "'p0' and 'p1' must be different points")
    else:
        axis = frame_towards((p1 - p0) / length)
        matrix = matrix @ translation(p0) @ axis @ scaling((radius, radius, length))
        if column_lengths_differ(matrix, (0, 1)) or is_sheared(matrix):
            remedy = "scale x and y alike, or use a mesh"
            properties.reading.refuse(properties.node, "'to_world' makes a cylinder's section no circle", remedy)
    return CylinderShape(to_world=frozen(matrix), flip_normals=flip, **common)


def _instance(properties: PropertyReader) -> Shape | None:
    node, reading = properties.node, properties.reading
    matrix = properties.transform()
    group_node = properties.only_child("shape", required=True)
    properties.finish()
    if group_node is None:
        return None
    if group_node.plugin != "shapegroup":
        reading.refuse(node, f"needs a shapegroup, not a '{group_node.plugin}'", "wrap the shape into a shapegroup")
        return None
    group = reading.once(group_node, lambda: _group(PropertyReader(group_node, reading)))
    return InstanceShape(id=node.id, location=node.location, group=group, to_world=frozen(matrix))


def _group(properties: PropertyReader) -> ShapeGroup:
    node, reading = properties.node, properties.reading
    members = [child for _, child in properties.children("shape")]
    properties.finish()
    if not members:
        reading.refuse(node, "has no shapes", "remove it and its instances")
    shapes: list[Shape] = []
    for member in members:
        if member.plugin in ("instance", "shapegroup"):
            reading.refuse(member, "cannot be inside a shapegroup", "Mitsuba's instances do not nest: flatten them")
            continue
        shape = read_shape(member, reading)
        if shape is not None and shape.emitter is not None:
            reading.refuse(member, "inside a shapegroup cannot emit light", "take the emitter out of the group")
        if shape is not None:
            shapes.append(shape)
    return ShapeGroup(node.id, tuple(shapes), node.location)


_READERS = {
    **dict.fromkeys(_MESH_FILES, _mesh_file),
    "cube": _cube,
    "rectangle": _rectangle,
    "disk": _disk,
    "sphere": _sphere,
    "cylinder": _cylinder,
}
