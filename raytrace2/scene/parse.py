"""Mitsuba's own parser (``mi.parser``) run on a file, a string or a dict, and its result as plain nodes.

Nothing of Mitsuba's state is changed: the variant is neither needed nor touched (importing a variant's module is
enough to make its types known), and the file resolver is put back.
"""

from __future__ import annotations

import importlib
import re
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Location, Problem, SceneError
from .defaults import OWN_TEXTURES
from .dict_check import DICT_SOURCE, check_dict
from .mitsuba_messages import problem_from_message
from .nodes import Color, DistortedTransform, LiveObject, Node, ParsedScene, SpectrumSamples, Value
from .xml_check import check_xml, decode
from .xml_text import SETTING_PREFIX, settings_in

STRING_SOURCE = "<string>"

_TAGS = {"reconstructionfilter": "rfilter", "phasefunction": "phase"}


def mitsuba_types() -> tuple[Any, Any]:
    """The packages ``mitsuba`` and ``mitsuba.scalar_rgb``, the latter for its types; no variant is set."""
    return importlib.import_module("mitsuba"), importlib.import_module("mitsuba.scalar_rgb")


def parse_file(path: str, parameters: dict[str, Any]) -> ParsedScene:
    """Parses the XML file ``path`` with ``$name`` filled in from ``parameters``; ``SceneError`` if it cannot."""
    file = Path(path)
    if not _is_file(file):
        raise SceneError([Problem("scene file not found", Location(str(path)), "check the path")])
    text = _read(file)
    mi, _ = mitsuba_types()
    own, plain = _split_settings(parameters)

    def run(config: Any, resolver: Any) -> Any:
        check_xml(text, str(path), plain, resolver)
        return mi.parser.parse_file(config, str(path), **plain)

    return _parse(run, str(path), folder=file.parent, own_settings=own, text=None)


def parse_string(xml: str, parameters: dict[str, Any]) -> ParsedScene:
    """Parses XML text; otherwise as :func:`parse_file`. Relative paths start at Mitsuba's working folder."""
    try:
        decode(xml.encode(), STRING_SOURCE)
    except UnicodeEncodeError:
        raise SceneError([Problem("is no text: it has half a character", Location(STRING_SOURCE))]) from None
    mi, _ = mitsuba_types()
    own, plain = _split_settings(parameters)

    def run(config: Any, resolver: Any) -> Any:
        check_xml(xml, STRING_SOURCE, plain, resolver)
        return mi.parser.parse_string(config, xml, **plain)

    return _parse(run, STRING_SOURCE, folder=None, own_settings=own, text=xml)


def parse_dict(scene: dict[str, Any], settings: dict[str, str] | None = None) -> ParsedScene:
    """Parses a dict as ``mi.load_dict`` takes it. Locations name the path of keys to the entry."""
    check_dict(scene)
    mi, _ = mitsuba_types()
    if scene.get("type") != "scene":
        raise SceneError([Problem("the dict is not a scene", Location(DICT_SOURCE), "it needs 'type': 'scene'")])

    def run(config: Any, _: Any) -> Any:
        return mi.parser.parse_dict(config, scene)

    return _parse(run, DICT_SOURCE, folder=None, own_settings=dict(settings or {}), text=None)


def _parse(
    run: Callable[[Any, Any], Any], source: str, *, folder: Path | None, own_settings: dict[str, str], text: str | None
) -> ParsedScene:
    mi, _ = mitsuba_types()
    config = mi.parser.ParserConfig("scalar_rgb")
    config.merge_meshes = False
    config.merge_equivalent = False
    with file_resolver(folder) as resolver:
        try:
            # The check moves its copy's search path along as it meets <path>, as the parser will move the other.
            state = run(config, mi.FileResolver(resolver))
            mi.parser.transform_upgrade(config, state)
        except SceneError:
            raise
        except Exception as error:  # Mitsuba raises RuntimeError, nanobind's casts raise others
            raise SceneError([problem_from_message(str(error), source)]) from None
        files = [str(file) for file in state.files]
        texts = [text if name == STRING_SOURCE and text is not None else _read(Path(name)) for name in files]
        settings: dict[str, str] = dict(own_settings)
        for xml in texts:
            for key, value in settings_in(xml).items():
                settings.setdefault(key, value)
        root = _nodes(state, files, texts)
    known = {file.stem for file in (Path(mi.__file__).parent / "plugins").glob("*.*")}
    return ParsedScene(
        root=root,
        resolve=lambda name: str(resolver.resolve(name)),
        is_plugin=lambda name: not known or name in known or name in OWN_TEXTURES,
        source=None if source in (STRING_SOURCE, DICT_SOURCE) else source,
        settings=settings,
    )


@contextmanager
def file_resolver(folder: Path | None) -> Iterator[Any]:
    """A copy of Mitsuba's file resolver, with ``folder`` searched first, in force inside the block."""
    mi, _ = mitsuba_types()
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    if folder is not None:
        resolver.prepend(str(folder))
    mi.set_file_resolver(resolver)
    try:
        yield resolver
    finally:
        mi.set_file_resolver(before)


def _read(path: Path) -> str:
    try:
        return decode(path.read_bytes(), str(path))
    except OSError as error:
        raise SceneError([Problem(f"cannot be read: {error.strerror}", Location(str(path)))]) from None


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long, or with a null character
        return False


def _split_settings(parameters: dict[str, Any]) -> tuple[dict[str, str], dict[str, Any]]:
    own = {k[len(SETTING_PREFIX) :]: str(v) for k, v in parameters.items() if k.startswith(SETTING_PREFIX)}
    return own, {k: v for k, v in parameters.items() if not k.startswith(SETTING_PREFIX)}


# --- Mitsuba's nodes as ours ----------------------------------------------------------------------------------------


def _nodes(state: Any, files: list[str], texts: list[str]) -> Node:
    raw = list(state.nodes)
    paths = list(state.node_paths)
    counts: dict[str, int] = {}
    taken = {node.props.id() for node in raw if node.props.id()}
    seen: set[str] = set()
    nodes: list[Node] = []
    starts = [_line_starts(text) for text in texts]
    for index, node in enumerate(raw):
        kind = str(node.type).rsplit(".", 1)[-1].lower()
        kind = _TAGS.get(kind, kind)
        written = name = node.props.id()
        while not name or name in seen:
            number = counts.get(kind, 0)
            counts[kind] = number + 1
            candidate = f"{name or kind}_{number}"
            name = candidate if candidate not in taken else name
        seen.add(name)
        if paths:
            location = Location(f"{DICT_SOURCE}[{paths[index]}]")
        else:
            location = Location(files[node.file_index], bisect_right(starts[node.file_index], node.offset) + 1)
        plugin = node.props.plugin_name()
        # In a dict nothing but Mitsuba's own list of plugins tells kinds.
        kind = "texture" if plugin in OWN_TEXTURES else kind
        nodes.append(Node(kind, plugin, name, location, name=written or name))
    problems: list[Problem] = []
    ids = dict(state.id_to_index)
    for index, node in enumerate(raw):
        _fill(nodes[index], node.props, nodes, ids, problems)
    problems += _cycles(nodes)
    if problems:
        raise SceneError(problems)
    return nodes[0]


def _line_starts(text: str) -> list[int]:
    data = text.encode("utf-8", "replace")
    return [match.end() for match in re.finditer(b"\n", data)]


def _fill(node: Node, props: Any, nodes: list[Node], ids: dict[str, int], problems: list[Problem]) -> None:
    mi, _ = mitsuba_types()
    types = mi.Properties.Type
    for name in props.keys():
        kind = props.type(name)
        if kind == types.ResolvedReference:
            node.children.append((name, nodes[props[name].index()]))
        elif kind == types.Reference:
            target = props[name].id()
            if target in ids:
                node.children.append((name, nodes[ids[target]]))
            else:
                message = f"plugin '{node.plugin}' refers to \"{target}\", which does not exist"
                problems.append(Problem(message, node.location, f'give some object id="{target}"'))
        else:
            node.properties[name] = _value(props, name, kind, types)


def _value(props: Any, name: str, kind: Any, types: Any) -> Value:
    value = props[name]
    if kind == types.Vector:
        return np.array([float(x) for x in value])
    if kind == types.Color:
        return Color((float(value[0]), float(value[1]), float(value[2])))
    if kind == types.Spectrum:
        return SpectrumSamples(tuple(value.wavelengths), tuple(value.values))
    if kind == types.Transform:
        return _transform(np.array(value.matrix, np.float64), np.array(value.inverse_transpose, np.float64))
    if kind in (types.Object, types.Any):
        return LiveObject(value)
    plain: Value = value
    return plain


def _transform(matrix: np.ndarray, inverse_transpose: np.ndarray) -> Value:
    linear, given = matrix[:3, :3], inverse_transpose[:3, :3]
    if np.isfinite(matrix).all() and np.isfinite(given).all():
        product = linear @ given.T
        # 1e-3 tells an axis of the wrong length from the rounding of float32, also of ill-conditioned matrices
        scale = np.abs(linear) @ np.abs(given.T)
        if (np.abs(product - np.eye(3)) > 1e-3 * np.maximum(scale, 1.0)).any():
            return DistortedTransform()
    return matrix


def _cycles(nodes: list[Node]) -> list[Problem]:
    """A problem for every node whose references lead back to itself; the walk keeps its own stack."""
    done: set[int] = set()
    problems: list[Problem] = []
    for start in nodes:
        if id(start) in done:
            continue
        path: list[Node] = [start]
        active = {id(start)}
        pending = [iter(start.children)]
        while pending:
            child = next(pending[-1], (None, None))[1]
            if child is None:
                finished = path.pop()
                active.discard(id(finished))
                done.add(id(finished))
                pending.pop()
            elif id(child) in active:
                loop = [n.id for n in path[path.index(child) :]] + [child.id]
                problems.append(
                    Problem(f"circular reference: {' -> '.join(loop)}", child.location, "remove one of the references")
                )
            elif id(child) not in done:
                path.append(child)
                active.add(id(child))
                pending.append(iter(child.children))
    return problems
