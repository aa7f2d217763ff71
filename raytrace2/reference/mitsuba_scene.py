"""A scene loaded into Mitsuba itself, at a chosen film size, with a digest of everything that shapes its image."""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Location, Problem, SceneError

Source = str | Path | Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class ParsedScene:
    """What Mitsuba's parser made of a source. ``digest`` is None when the source holds live Mitsuba objects, whose
    content no digest can cover; ``size`` is the (width, height) that sensor's film renders."""

    state: Any
    config: Any
    digest: str | None
    size: tuple[int, int]


@contextlib.contextmanager
def mitsuba_variant(variant: str) -> Iterator[Any]:
    """The mitsuba module with ``variant`` set; the caller's variant and file search path are restored on leaving."""
    import mitsuba

    mi: Any = mitsuba
    before = mi.variant()
    mi.set_variant(variant)
    resolver = mi.file_resolver()
    mi.set_file_resolver(type(resolver)(resolver))
    try:
        yield mi
    finally:
        mi.set_file_resolver(resolver)
        if before is not None:
            mi.set_variant(before)


@contextlib.contextmanager
def mitsuba_errors(source: Source) -> Iterator[None]:
    """Turns what Mitsuba raises into a one-line :class:`SceneError`."""
    try:
        yield
    except SceneError:
        raise
    except (RuntimeError, ValueError, TypeError) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        location = _location(source)
        placed = re.search(r"Error while loading (?:scene )?\"?(.+?)\"? \((?:near )?line (\d+), col \d+\): (.*)", text)
        if placed:
            location, text = Location(placed[1], int(placed[2])), placed[3]
        raise SceneError([Problem(f"Mitsuba cannot render this scene: {text}", location)]) from error


def parse(
    mi: Any,
    source: Source,
    parameters: Mapping[str, Any],
    sensor: int,
    size: tuple[int, int] | None,
    resolution_scale: float,
    sampler: str | None,
) -> ParsedScene:
    """Parses ``source`` (an XML file's path, XML text, or a Mitsuba dict) and settles film size and sampler.

    Every film gets the new size (Mitsuba's scenes often share one between sensors); ``sampler`` replaces the plugin of
    every sampler. ``SceneError`` for what Mitsuba's parser refuses, ``ValueError`` for a sensor or size that cannot be.
    """
    parser = mi.parser
    config = parser.ParserConfig(mi.variant())
    config.unused_parameters = mi.LogLevel.Debug
    with mitsuba_errors(source):
        if isinstance(source, Mapping):
            state = parser.parse_dict(config, dict(source))
        elif is_xml_text(source):
            state = parser.parse_string(config, source, **parameters)
        else:
            if not Path(source).is_file():
                raise SceneError([Problem("no such scene file", _location(source), "check the path")])
            # The scene's own folder is searched too, as mi.load_file does.
            mi.file_resolver().prepend(str(Path(source).resolve().parent))
            state = parser.parse_file(config, str(source), **parameters)
        parser.transform_all(config, state)

    def of_type(kind: Any) -> list[Any]:
        return [node for node in state.nodes if node.type == kind]

    for node in of_type(mi.ObjectType.Film):
        _resize(node.props, size, resolution_scale)
    if sampler is not None:
        for node in of_type(mi.ObjectType.Sampler):
            node.props.set_plugin_name(sampler)
    sensors = of_type(mi.ObjectType.Sensor)
    if not 0 <= sensor < len(sensors):
        raise ValueError(f"the scene has {len(sensors)} sensors: there is no sensor {sensor}")
    return ParsedScene(state, config, _digest(mi, state), _film_size(mi, state, sensors[sensor]))


def instantiate(mi: Any, parsed: ParsedScene, source: Source) -> Any:
    """The live ``mi.Scene``; ``SceneError`` for what Mitsuba cannot make."""
    with mitsuba_errors(source):
        made = mi.parser.instantiate(parsed.config, parsed.state)
        return made[0] if isinstance(made, (list, tuple)) else made


def is_xml_text(source: Any) -> bool:
    """Whether a string is XML text and not a path."""
    return isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<")


def _location(source: Source) -> Location | None:
    return None if isinstance(source, Mapping) or is_xml_text(source) else Location(str(source))


def _resize(props: Any, size: tuple[int, int] | None, scale: float) -> None:
    """Mitsuba's film defaults (768 x 576, no crop) and crop window follow the new size in proportion."""
    old = (int(props.get("width", 768)), int(props.get("height", 576)))
    new = size if size is not None else tuple(max(1, round(n * scale)) for n in old)
    if new == old:
        return
    props["width"], props["height"] = int(new[0]), int(new[1])
    for axis, (side, offset) in enumerate((("crop_width", "crop_offset_x"), ("crop_height", "crop_offset_y"))):
        if side in props or offset in props:
            ratio = new[axis] / old[axis]
            start = min(round(int(props.get(offset, 0)) * ratio), new[axis] - 1)
            length = max(1, round(int(props.get(side, old[axis])) * ratio))
            props[offset], props[side] = start, min(length, new[axis] - start)


def _film_size(mi: Any, state: Any, sensor: Any) -> tuple[int, int]:
    for _, value in sensor.props.items():
        if isinstance(value, mi.Properties.ResolvedReference):
            node = state.nodes[value.index()]
            if node.type == mi.ObjectType.Film:
                width, height = int(node.props.get("width", 768)), int(node.props.get("height", 576))
                return int(node.props.get("crop_width", width)), int(node.props.get("crop_height", height))
    return 768, 576


def _digest(mi: Any, state: Any) -> str | None:
    """SHA-256 over all nodes, their properties, and the bytes of the files that they name."""
    digest = hashlib.sha256()
    for node in state.nodes:
        digest.update(f"\x01{node.type}\x02{node.props.plugin_name()}\x02{node.props.id()}".encode())
        for name, value in node.props.items():
            content = _content(mi, name, value)
            if content is None:
                return None
            digest.update(f"\x03{name}\x02{type(value).__name__}\x02".encode() + content)
    return digest.hexdigest()


def _content(mi: Any, name: str, value: Any) -> bytes | None:
    if isinstance(value, str):
        path = Path(str(mi.file_resolver().resolve(value))) if value else None
        if name.endswith("filename") and path is not None and path.is_file():
            return b"file:" + hashlib.sha256(path.read_bytes()).digest()
        return value.encode()
    if isinstance(value, (bool, int, float)):
        return repr(value).encode()
    if isinstance(value, mi.Properties.ResolvedReference):
        return repr(value.index()).encode()
    if isinstance(value, mi.Bitmap):
        array = np.ascontiguousarray(value)
        return f"{array.shape}{array.dtype}{value.srgb_gamma()}".encode() + array.tobytes()
    if hasattr(value, "wavelengths") and hasattr(value, "values"):
        return repr((list(value.wavelengths), list(value.values))).encode()
    try:
        array = np.ascontiguousarray(np.asarray(getattr(value, "matrix", value)))
    except (TypeError, ValueError, RuntimeError):
        return None
    return None if array.dtype == object else f"{array.shape}{array.dtype}".encode() + array.tobytes()
