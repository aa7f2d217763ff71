"""The scoreboard as a picture: a row a figure, a column one who takes part, from right (pale) to wrong (dark); below it
the trade, as bars of rays per second."""

from __future__ import annotations

import math

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .figures import FIGURES, Figure
from .scoreboard import Found
from .sweep import Record

_SIZE = 14
_CELL = (92, 26)
_GOOD, _NEAR, _FAR = (199, 233, 192), (254, 217, 118), (189, 0, 38)


_SAFE, _FAST = (69, 117, 180), (171, 217, 233)


def picture(found: Found, traded: dict[str, Record]) -> np.ndarray:
    """(H, W, 3) uint8."""
    panels = [_scoreboard(found)] if found else []
    panels += [_trade(traded)] if traded else []
    sheet = Image.new("RGB", (max(p.width for p in panels), sum(p.height for p in panels)), "white")
    top = 0
    for panel in panels:
        sheet.paste(panel, (0, top))
        top += panel.height
    return np.asarray(sheet)


def _trade(traded: dict[str, Record]) -> Image.Image:
    """Bars of rays per second on a logarithmic axis, watertight and fast, and what leaks without care."""
    font = ImageFont.load_default(_SIZE)
    kinds = list(dict.fromkeys(key.split()[0] for key in traded))
    rows = [(k, p) for p in ("float32", "float64") for k in kinds]
    left, length, row = 230, 420, 34
    image = Image.new("RGB", (left + length + 420, 60 + row * len(rows)), "white")
    draw = ImageDraw.Draw(image)
    draw.text((10, 4), "What safety costs: million rays per second", "black", font)
    for x, color, name in ((left, _SAFE, "watertight"), (left + 110, _FAST, "fast")):
        draw.rectangle((x, 30, x + 12, 42), color)
        draw.text((x + 18, 28), name, "black", font)
    draw.text((left + length + 70, 28), "leaks of fast: at vertices, at edges", "black", font)
    rates = [r["rate"] for r in traded.values()]
    low, high = math.log10(min(rates)) - 0.3, math.log10(max(rates))
    for j, (kind, precision) in enumerate(rows):
        y = 54 + j * row
        draw.text((10, y + 5), f"{kind}, {precision}", "black", font)
        for k, (way, color) in enumerate((("watertight", _SAFE), ("fast", _FAST))):
            rate = traded[f"{kind} {precision} {way}"]["rate"]
            end = left + length * (math.log10(rate) - low) / (high - low)
            draw.rectangle((left, y + 14 * k, end, y + 14 * k + 12), color)
            draw.text((end + 6, y + 14 * k - 2), f"{rate / 1e6:.2g}", "black", font)
        fast = traded[f"{kind} {precision} fast"]
        said = f"{fast['vertex']:,}, {fast['edge']:,} of {fast['rays']:,}"
        draw.text((left + length + 70, y + 5), said, "black", font)
    return image


def _scoreboard(found: Found) -> Image.Image:
    columns: list[tuple[str, str]] = []
    for precision in ("float32", "float64"):
        names = list(dict.fromkeys(n for f in FIGURES for n in found.get((f.key, precision), {})))
        columns += sorted(((precision, n) for n in names), key=lambda c: c[1].startswith("Embree"))
    rows = [f for f in FIGURES if any((f.key, p) in found for p in ("float32", "float64"))]
    font = ImageFont.load_default(_SIZE)
    left = 20 + max((int(font.getlength(f.title)) for f in rows), default=0)
    tall = 70 + max((int(font.getlength(n)) for _, n in columns), default=0)
    image = Image.new("RGB", (left + len(columns) * _CELL[0] + 12, tall + len(rows) * _CELL[1] + 12), "white")
    draw = ImageDraw.Draw(image)
    draw.text((10, 8), "What goes wrong at the extremes: green is as wanted, red the more the worse", "black", font)
    for k, (precision, name) in enumerate(columns):
        x = left + k * _CELL[0]
        _upright(image, name, (x + 34, tall - 8), font)
        if k == 0 or columns[k - 1][0] != precision:
            draw.text((x, 34), precision, "black", font)
            draw.line((x - 2, 34, x - 2, image.height - 12), "black")
    for j, f in enumerate(rows):
        y = tall + j * _CELL[1]
        draw.text((10, y + 4), f.title, "black", font)
        for k, (precision, name) in enumerate(columns):
            record = found.get((f.key, precision), {}).get(name)
            if record is None:
                continue
            x = left + k * _CELL[0]
            fill = _colour(f, record, precision)
            draw.rectangle((x, y, x + _CELL[0] - 3, y + _CELL[1] - 3), fill)
            text = _text(record)
            ink = "black" if sum(fill) > 380 else "white"
            draw.text((x + (_CELL[0] - 3 - font.getlength(text)) / 2, y + 4), text, ink, font)
    return image


def _colour(figure: Figure, record: Record, precision: str) -> tuple[int, int, int]:
    """Green if as wanted, else from yellow to red with the decades that are lacking (six are all)."""
    value = _worst(record)
    if figure.good(value, precision):
        return _GOOD
    limit = figure.limit[precision == "float64"]
    # A count is compared with one in as many rays as there were.
    floor = limit if limit else 1.0
    share = min(max(math.log10(value / floor) / 6, 0.0), 1.0) if math.isfinite(value) else 1.0
    r, g, b = (round(n + share * (f - n)) for n, f in zip(_NEAR, _FAR, strict=True))
    return r, g, b


def _worst(record: Record) -> float:
    value = record["value"]
    return math.inf if value is None or math.isnan(value) else max(value, record.get("self_hits", 0))


def _text(record: Record) -> str:
    value = record["value"]
    if value is None or not math.isfinite(value):
        return "none"
    text = f"{value:,}" if isinstance(value, int) else f"{value:.2g}"
    return text + (f"; {record['self_hits']:,}" if record.get("self_hits") else "")


def _upright(
    image: Image.Image, text: str, foot: tuple[int, int], font: ImageFont.FreeTypeFont | ImageFont.ImageFont
) -> None:
    """Writes from the bottom to the top, ending where ``foot`` is."""
    strip = Image.new("RGB", (int(font.getlength(text)) + 2, _SIZE + 6), "white")
    ImageDraw.Draw(strip).text((0, 0), text, fill="black", font=font)
    turned = strip.rotate(90, expand=True)
    image.paste(turned, (foot[0], foot[1] - turned.height))
