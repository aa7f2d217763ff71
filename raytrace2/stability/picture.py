"""The scoreboard as a picture: a row a figure, a column one who takes part, from right (pale) to wrong (dark); below it
the trade, as bars of rays per second."""

from __future__ import annotations

import math

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .figures import FIGURES, Figure
from .scoreboard import Found, Traded
from .sweep import Record
from .table import per_million

_SIZE = 14
_CELL = (92, 26)
_GOOD, _NEAR, _FAR = (199, 233, 192), (254, 217, 118), (189, 0, 38)


#: Tests of triangles and margins of boxes.
_BARS = {
    "watertight, padded": (69, 117, 180),
    "watertight, bare": (116, 173, 209),
    "fast, padded": (253, 174, 97),
    "fast, bare": (244, 109, 67),
}


def picture(found: Found, traded: Traded) -> np.ndarray:
    """(H, W, 3) uint8."""
    panels = [_scoreboard(found)] if found else []
    panels += [_trade(traded)] if traded else []
    sheet = Image.new("RGB", (max(p.width for p in panels), sum(p.height for p in panels)), "white")
    top = 0
    for panel in panels:
        sheet.paste(panel, (0, top))
        top += panel.height
    return np.asarray(sheet)


def _trade(traded: Traded) -> Image.Image:
    """A bar of rays per second for every structure and way, on a logarithmic axis, beside it what goes wrong."""
    font = ImageFont.load_default(_SIZE)
    rows = [(kind, way, record) for kind, records in traded.items() for way, record in records.items()]
    left, length, row = 360, 380, 20
    columns = ("at vertices", "at edges", "edges, far", "error of t")
    image = Image.new("RGB", (left + length + 60 + 100 * len(columns), 76 + row * len(rows)), "white")
    draw = ImageDraw.Draw(image)
    draw.text((10, 4), "What safety costs: million rays per second; what leaks of a million rays", "black", font)
    for k, (way, color) in enumerate(_BARS.items()):
        draw.rectangle((10 + 170 * k, 32, 22 + 170 * k, 44), color)
        draw.text((28 + 170 * k, 29), way, "black", font)
    aside = left + length + 60
    for k, title in enumerate(columns):
        draw.text((aside + 100 * k, 50), title, "black", font)
    rates = [record["rate"] for _, _, record in rows]
    low, high = math.log10(min(rates)) - 0.3, math.log10(max(rates))
    for j, (kind, way, record) in enumerate(rows):
        y = 72 + j * row
        if j and kind != rows[j - 1][0]:
            draw.line((10, y - 2, image.width - 12, y - 2), (200, 200, 200))
        draw.text((10, y), f"{kind}, {way}", "black", font)
        end = left + length * (math.log10(record["rate"]) - low) / (high - low)
        draw.rectangle((left, y + 2, end, y + row - 4), _BARS[way.partition(", ")[2]])
        draw.text((end + 6, y), f"{record['rate'] / 1e6:.2g}", "black", font)
        said = [per_million(record[key], record["rays"]) for key in ("vertex", "edge", "far")]
        for k, text in enumerate((*said, f"{record['t']:.1g}")):
            ink = (189, 0, 38) if k < len(said) and text != "0" else (0, 0, 0)
            draw.text((aside + 100 * k, y), text, ink, font)
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
