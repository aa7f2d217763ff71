"""What has to be known of the XML text itself: the settings it has for us, and how deep it may nest."""

from __future__ import annotations

import html
import re

MAX_DEPTH = 100
SETTING_PREFIX = "raytrace2."

_SKIPPED = re.compile(r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>", re.DOTALL)
_DEFAULT = re.compile(r"""<default\b(?P<rest>(?:[^<>"']|"[^"]*"|'[^']*')*)>""")
_ATTRIBUTE = re.compile(r"""([A-Za-z_][\w.-]*)\s*=\s*("[^"]*"|'[^']*')""")


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
