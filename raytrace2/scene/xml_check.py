"""What a scene's XML must not do to Mitsuba's parser, found before it runs: recursion, expansion and files without end.

Mitsuba recurses over elements, copies parameters into each other (``<default>`` within ``<default>``), reads files
again and again (``<include>`` within ``<include>``), and reads what is no file. Here the text is walked the way Mitsuba
walks it, files that it includes too, and refused where that would exhaust the stack, memory or time. Paths are taken
relative to the file that names them and may be absolute or climb with ``..``; addresses on the web are refused.
"""

from __future__ import annotations

import html
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import Location, Problem, SceneError
from .xml_text import MAX_DEPTH

_MOST_FILES = 1000
_MOST_EXPANDED = 1 << 24

_TOKEN = re.compile(
    r"""<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<\?.*?(?:\?>|\Z)"""
    r"""|<(?P<close>/?)(?P<tag>[A-Za-z_:\x80-\U0010ffff][^\s<>/"']*)(?P<rest>(?:[^<>"']|"[^"]*"|'[^']*')*)>""",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"""([^\s=<>"'/]+)\s*=\s*("[^"]*"|'[^']*')""")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_LATIN_1 = re.compile(rb"""\A\s*<\?xml[^>]*encoding\s*=\s*["'](?:iso-8859-1|latin1)["']""", re.IGNORECASE)
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")


def is_url(name: str) -> bool:
    """Whether a file's name is an address on the web, or of another scheme."""
    return _URL.match(name) is not None


def decode(data: bytes, source: str) -> str:
    """The text of an XML file; ``SceneError`` if it is neither UTF-8 nor declared Latin-1 outside its comments."""
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise _error("is no UTF-8 text: it has a null character", source, line, "save it as UTF-8")
    if _LATIN_1.match(data):
        return data.decode("latin-1")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        pass
    try:
        # Comments may hold anything, as no parser looks into them.
        _COMMENT.sub(lambda match: re.sub(rb"[^\n]", b" ", match[0]), data).decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise _error("is no UTF-8 text", source, line, "save it as UTF-8") from None
    return data.decode("utf-8", "replace")


def check_xml(text: str, source: str, parameters: dict[str, Any], resolver: Any) -> None:
    """``SceneError`` for a text that must not be parsed. ``resolver`` is a copy of the file resolver that the parser
    will use, and ``parameters`` what it will put in place of ``$name``."""
    _Walk({f"${key}": str(value) for key, value in parameters.items()}).file(text, source, resolver, 0)


@dataclass
class _Walk:
    parameters: dict[str, str]
    files: int = 0
    expanded: int = 0
    depth: int = field(default=0, init=False)

    def file(self, text: str, source: str, resolver: Any, includes: int) -> None:
        depth = 0
        for tag, close, rest, start in _tags(text):
            if close:
                # Text that is not well-formed must not make room for more.
                depth = max(depth - 1, 0)
                continue

            def line(at: int = start) -> int:
                return text.count("\n", 0, at) + 1

            if depth >= MAX_DEPTH and not rest.endswith("/"):
                raise _error(f"elements are nested more than {MAX_DEPTH} deep", source, line(), "flatten the scene")
            depth += not rest.endswith("/")
            if tag not in ("default", "include", "path", "spectrum", "matrix") and "$" not in rest and "&" not in rest:
                continue
            attributes = {
                key: self._expand(html.unescape(v[1:-1]), source, line) for key, v in _ATTRIBUTE.findall(rest)
            }
            if tag == "default" and attributes.get("name"):
                self.parameters.setdefault(f"${attributes['name']}", attributes.get("value", ""))
            elif tag == "matrix":
                _require_affine(attributes.get("value", ""), source, line())
            elif tag == "path":
                _prepend(resolver, attributes.get("value", ""), source)
            elif "filename" in attributes and tag in ("include", "spectrum"):
                path = _regular_file(attributes["filename"], source, line(), resolver)
                if tag == "include" and path:
                    self._include(path, source, line(), resolver, includes)

    def _include(self, path: str, source: str, line: int, resolver: Any, includes: int) -> None:
        self.files += 1
        if self.files > _MOST_FILES:
            raise _error(f"more than {_MOST_FILES} files are included", source, line, "put them into fewer files")
        # Mitsuba ends by itself where files include each other in a circle, and says so better.
        if includes < 16:
            inside = type(resolver)(resolver)
            inside.prepend(os.path.dirname(source) or ".")
            text = decode(Path(path).read_bytes(), path)
            self.file(text, path, inside, includes + 1)

    def _expand(self, value: str, source: str, line: Any) -> str:
        if "$" not in value:
            return value
        before = len(value)
        for key in sorted(self.parameters, key=len, reverse=True):
            new = self.parameters[key]
            if key in value and value.count(key) * len(new) > _MOST_EXPANDED:
                self.expanded = _MOST_EXPANDED + 1
                break
            value = value.replace(key, new)
        self.expanded += max(len(value) - before, 0)
        if self.expanded > _MOST_EXPANDED:
            message = f"parameters expand to more than {_MOST_EXPANDED >> 20} million characters"
            raise _error(message, source, line(), "do not put <default> values into each other so often")
        return value


def _tags(text: str) -> Iterator[tuple[str, str, str, int]]:
    for match in _TOKEN.finditer(text):
        if match["tag"]:
            yield match["tag"], match["close"], match["rest"], match.start()


def _prepend(resolver: Any, folder: str, source: str) -> None:
    here = os.path.join(os.path.dirname(source), folder)
    found = here if os.path.exists(here) else str(resolver.resolve(folder))
    if os.path.isdir(found):
        resolver.prepend(found)


def _require_affine(value: str, source: str, line: int) -> None:
    """The last row of a 4 x 4 matrix, which Mitsuba does not look at."""
    row = value.replace(",", " ").split()[12:]
    try:
        affine = len(row) != 4 or tuple(map(float, row)) == (0.0, 0.0, 0.0, 1.0)
    except ValueError:
        affine = False
    if not affine:
        raise _error(f"the last row of a <matrix> is {' '.join(row)}", source, line, "it must be 0 0 0 1")


def _regular_file(name: str, source: str, line: int, resolver: Any) -> str | None:
    """Where the file is; None if Mitsuba will not find it either. ``SceneError`` if it is none."""
    if is_url(name):
        raise _error(f"'{name}' is an address, not a file", source, line, "download it and name the file")
    inside = type(resolver)(resolver)
    inside.prepend(os.path.dirname(source) or ".")
    path = str(inside.resolve(name))
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return None
    if not stat.S_ISREG(mode):
        raise _error(f"'{name}' is not a regular file", source, line, "give the path of a file")
    return path


def _error(message: str, source: str, line: int, remedy: str) -> SceneError:
    return SceneError([Problem(message, Location(source, line), remedy)])
