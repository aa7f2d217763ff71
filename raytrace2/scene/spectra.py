"""Colours and spectra as the linear RGB triple that Mitsuba's RGB variants would make of them.

Plain numbers and RGB are trivial. Spectra (tables of wavelengths) are put, alone, into a plugin that Mitsuba
instantiates in its ``scalar_rgb`` variant, whose parameter is then read back: the conversion is Mitsuba's own.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from .nodes import Color, DistortedTransform, LiveObject, SpectrumSamples, Value
from .parse import file_resolver, mitsuba_types

# What the spectrum is for: a reflectance lies in [0, 1]; an emission is not weighted by the D65 illuminant
Role = Literal["reflectance", "unbounded", "emission"]
RGB = tuple[float, float, float]

_CARRIERS = {
    "reflectance": ("diffuse", "reflectance"),
    "unbounded": ("conductor", "eta"),
    "emission": ("point", "intensity"),
}


def constant_rgb(value: Value, role: Role) -> RGB:
    """The RGB triple (float32 values) of a number, colour or spectrum; ``ValueError`` if ``role`` cannot have it."""
    if isinstance(value, bool | str | np.ndarray | LiveObject | DistortedTransform):
        raise ValueError("a number, an rgb colour or a spectrum is needed")
    if isinstance(value, int | float):
        rgb = _single((float(value),) * 3)
    elif isinstance(value, Color):
        rgb = _single(value.value)
        if role == "reflectance" and not all(0.0 <= c <= 1.0 for c in rgb):
            raise ValueError(f"reflectances lie between 0 and 1, not {_shown(rgb)}")
    else:
        rgb = spectrum_rgb(value, role)
    if not all(math.isfinite(c) for c in rgb):
        raise ValueError(f"finite values are needed, not {_shown(rgb)}")
    if min(rgb) < 0.0 and not (isinstance(value, SpectrumSamples) and min(value.values) >= 0.0):
        raise ValueError(f"negative values make no sense, here {_shown(rgb)}")
    return rgb


def spectrum_rgb(spectrum: SpectrumSamples, role: Role) -> RGB:
    """The RGB triple of a tabulated or uniform spectrum."""
    if not all(math.isfinite(v) for v in (*spectrum.values, *spectrum.wavelengths)):
        raise ValueError("the spectrum has values that are not finite")
    value: Any = spectrum.values[0]
    if spectrum.wavelengths:
        value = list(zip(spectrum.wavelengths, spectrum.values, strict=True))
    plugin, name = _CARRIERS[role]
    entry = {"type": plugin, name: {"type": "spectrum", "value": value}}
    return _triple(plugin_parameters(entry)[f"{name}.value"])


def conductor_rgb(material: str) -> tuple[RGB, RGB]:
    """``eta`` and ``k`` of a conductor that Mitsuba knows by name, such as ``Al``; ``ValueError`` for others."""
    if material not in (names := material_names()):
        raise ValueError(f"the material '{material}' is unknown, known are: none, {', '.join(names)}")
    found = plugin_parameters({"type": "conductor", "material": material})
    return _triple(found["eta.value"]), _triple(found["k.value"])


def material_names() -> list[str]:
    """The conductors in Mitsuba's data folder."""
    from pathlib import Path

    folder = Path(mitsuba_types()[0].__file__).parent / "data" / "ior"
    return sorted(file.name.removesuffix(".eta.spd") for file in folder.glob("*.eta.spd"))


def plugin_parameters(entry: dict[str, Any]) -> dict[str, Any]:
    """The parameters, as ``mi.traverse`` names them, of the dict ``entry`` instantiated alone as ``scalar_rgb``."""
    mi, variant = mitsuba_types()
    config = mi.parser.ParserConfig("scalar_rgb")
    config.parallel = False
    try:
        with file_resolver(None):
            state = mi.parser.parse_dict(config, entry)
            mi.parser.transform_resolve(config, state)
            instance = mi.parser.instantiate(config, state)
    except RuntimeError as error:
        raise ValueError(" ".join(str(error).rsplit("]", 1)[-1].split())) from None
    found: dict[str, Any] = {}
    base: Any = variant.TraversalCallback

    class Collector(base):
        def __init__(self, owner: Any, prefix: str) -> None:
            super().__init__()
            self.owner, self.prefix = owner, prefix

        # Mitsuba passes (name, object, flags) for children and (name, pointer, flags, C++ type) for values
        def put(self, name: str, value: Any, flags: int, cpp_type: Any = None) -> None:
            if cpp_type is not None:
                found[self.prefix + name] = variant.get_property(value, cpp_type, self.owner)
            elif value is not None:
                value.traverse(Collector(value, f"{self.prefix}{name}."))

    instance.traverse(Collector(instance, ""))
    return found


def _triple(value: Any) -> RGB:
    if isinstance(value, float):
        return (value, value, value)
    return (float(value[0]), float(value[1]), float(value[2]))


def _single(values: tuple[float, ...]) -> RGB:
    r, g, b = (float(v) for v in np.asarray(values, dtype=np.float64).astype(np.float32))
    return (r, g, b)


def _shown(rgb: RGB) -> str:
    return f"({rgb[0]:g}, {rgb[1]:g}, {rgb[2]:g})"
