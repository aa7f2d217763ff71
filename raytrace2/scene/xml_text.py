"""What has to be known of the XML text itself: that it is not nested absurdly deep, and the settings it has for us."""

from __future__ import annotations

import html
import re

from ..errors import Location, Problem, SceneError

MAX_DEPTH = 100
SETTING_PREFIX = "raytrace2."

_SKIPPED = re.compile(r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>", re.DOTALL)
_TAG = re.compile(r"""<(?P<close>/?)[A-Za-z_][^\s<>/"']*(?P<rest>(?:[^<>"']|"[^"]*"|'[^']*')*)>""")
_DEFAULT = re.compile(r"""<default\b(?P<rest>(?:[^<>"']|"[^"]*"|'[^']*')*)>""")
_ATTRIBUTE = re.compile(r"""([A-Za-z_][\w.-]*)\s*=\s*("[^"]*"|'[^']*')""")


def check_depth(text: str, source: str) -> None:
    """``SceneError`` when elements nest deeper than 100: Mitsuba's parser recurses and would overflow its stack."""
    depth = 0
    for match in _TAG.finditer(_SKIPPED.sub(_blank, text)):
        if match["close"]:
            depth -= 1
        elif not match["rest"].endswith("/"):
            depth += 1
            if depth > MAX_DEPTH:
                line = text.count("\n", 0, match.start()) + 1
                message = f"elements are nested more than {MAX_DEPTH} deep"
                raise SceneError([Problem(message, Location(source, line), "flatten the scene")])


def settings_in(text: str) -> dict[str, str]:
    """The ``<default name="raytrace2.KEY" value="..."/>`` of ``text`` as ``{KEY: value}``; the first of a key wins.

    Mitsuba accepts a ``<default>`` of any name and ignores those that no ``$name`` uses.
    """
    found: dict[str, str] = {}
    for match in _DEFAULT.finditer(_SKIPPED.sub(_blank, text)):
        attributes = {key: html.unescape(value[1:-1]) for key, value in _ATTRIBUTE.findall(match["rest"])}
        name = attributes.get("name", "")
        if name.startswith(SETTING_PREFIX) and len(name) > len(SETTING_PREFIX):
            found.setdefault(name[len(SETTING_PREFIX) :], attributes.get("value", ""))
    return found


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", match[0])
