"""Integrator nodes."""

from __future__ import annotations

from .description import Integrator
from .nodes import Node
from .reading import PropertyReader, Reading

AOV_KINDS = (
    "albedo", "depth", "position", "uv", "geo_normal", "sh_normal", "dp_du", "dp_dv", "duv_dx", "duv_dy",
    "footprint_flags", "prim_index", "shape_index", "accel.volumes", "accel.nodes", "accel.primitives",
)  # fmt: skip


def read_integrator(node: Node, reading: Reading) -> Integrator:
    """The integrator ``node``; a problem and a placeholder if it is not supported."""
    reader = _READERS.get(node.plugin)
    if reader is None:
        reading.unsupported(node, _READERS)
        return Integrator()
    properties = PropertyReader(node, reading)
    # Read by every Mitsuba integrator; they say how it renders, not what
    properties.ignore("block_size", "samples_per_pass")
    if properties.number("timeout", default=-1.0) >= 0.0:
        reading.refuse(node, "'timeout' is not supported: it would leave the image unfinished", "leave it out")
    integrator = reader(properties)
    properties.finish()
    return integrator


def _path(properties: PropertyReader) -> Integrator:
    return Integrator(
        "path",
        max_depth=properties.integer("max_depth", least=-1),
        rr_depth=properties.integer("rr_depth", least=1),
        hide_emitters=properties.boolean("hide_emitters"),
    )


def _direct(properties: PropertyReader) -> Integrator:
    both = properties.integer("shading_samples", least=0)
    separate = [name for name in ("emitter_samples", "bsdf_samples") if properties.has(name)]
    if properties.has("shading_samples") and separate:
        properties.reading.refuse(
            properties.node, f"has both 'shading_samples' and '{separate[0]}'", "keep one of them"
        )
    emitter_samples = properties.integer("emitter_samples", least=0, default=both)
    bsdf_samples = properties.integer("bsdf_samples", least=0, default=both)
    if emitter_samples + bsdf_samples == 0:
        properties.reading.refuse(properties.node, "needs at least one emitter or BSDF sample")
    return Integrator(
        "direct",
        max_depth=2,
        hide_emitters=properties.boolean("hide_emitters"),
        emitter_samples=emitter_samples,
        bsdf_samples=bsdf_samples,
    )


def _aov(properties: PropertyReader) -> Integrator:
    node, reading = properties.node, properties.reading
    aovs: list[tuple[str, str]] = []
    for token in properties.string("aovs").replace(",", " ").split():
        name, _, kind = token.partition(":")
        if not name or kind not in AOV_KINDS:
            reading.refuse(node, f"the aov '{token}' must be name:kind", f"kinds are: {', '.join(AOV_KINDS)}")
        aovs.append((name, kind))
    nested = properties.only_child("integrator")
    if nested is not None and nested.plugin == "aov":
        reading.refuse(nested, "cannot be inside another aov integrator", "list all aovs in one")
        nested = None
    hide_emitters = properties.boolean("hide_emitters")
    if not aovs:
        reading.refuse(node, "'aovs' lists nothing", 'name some, such as aovs="depth:depth"')
    inner = read_integrator(nested, reading) if nested is not None else None
    return Integrator("aov", hide_emitters=hide_emitters, aovs=tuple(aovs), nested=inner)


_READERS = {"path": _path, "direct": _direct, "aov": _aov}
