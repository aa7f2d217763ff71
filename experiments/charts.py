"""Charts drawn with Pillow: a table of numbers as colours, and curves over logarithmic axes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

#: A scale that also reads in grey, from little to much.
_STOPS = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)], float)

_LINES = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#8c564b", "#17becf", "#e377c2", "#7f7f7f", "#bcbd22")

_SIZE = 13

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont


def colour(value: float) -> tuple[int, int, int]:
    """A colour for a number from 0 to 1."""
    place = min(max(value, 0.0), 1.0) * (len(_STOPS) - 1)
    k = min(int(place), len(_STOPS) - 2)
    r, g, b = _STOPS[k] + (place - k) * (_STOPS[k + 1] - _STOPS[k])
    return int(r), int(g), int(b)


def heat_chart(
    title: str, rows: Sequence[str], columns: Sequence[str], panels: Mapping[str, Sequence[Sequence[float | None]]]
) -> np.ndarray:
    """(H, W, 3) uint8: for each panel a table of ``rows`` x ``columns``, coloured by its numbers, which lie in 0 to 1
    and are written as percentages; None is left blank."""
    font, cell = ImageFont.load_default(_SIZE), (42, 20)
    left = 16 + max(int(font.getlength(r)) for r in rows)
    tall = 34 + max(int(font.getlength(c)) for c in columns)
    panel = tall + len(rows) * cell[1] + 34
    image = Image.new("RGB", (left + len(columns) * cell[0] + 60, 30 + panel * len(panels)), "white")
    draw = ImageDraw.Draw(image)
    draw.text((8, 6), title, fill="black", font=font)
    for k, (name, values) in enumerate(panels.items()):
        top = 30 + k * panel
        draw.text((8, top + 4), name, fill="black", font=font)
        for j, column in enumerate(columns):
            _upright(image, column, (left + j * cell[0] + 12, top + tall - 6), font)
        for i, row in enumerate(rows):
            y = top + tall + i * cell[1]
            draw.text((8, y + 2), row, fill="black", font=font)
            for j, value in enumerate(values[i]):
                if value is None:
                    continue
                x = left + j * cell[0]
                draw.rectangle((x, y, x + cell[0] - 2, y + cell[1] - 2), fill=colour(value))
                ink = "black" if value > 0.6 else "white"
                draw.text((x + 8, y + 2), f"{100 * value:.0f}", fill=ink, font=font)
    return np.asarray(image)


def _upright(image: Image.Image, text: str, foot: tuple[int, int], font: Font) -> None:
    """Writes from the bottom to the top, ending where ``foot`` is."""
    strip = Image.new("RGB", (int(font.getlength(text)) + 2, _SIZE + 5), "white")
    ImageDraw.Draw(strip).text((0, 0), text, fill="black", font=font)
    turned = strip.rotate(90, expand=True)
    image.paste(turned, (foot[0], foot[1] - turned.height))


Curve = Sequence[tuple[float, float]]


def log_charts(title: str, panels: Mapping[str, Mapping[str, Curve]], x_name: str) -> np.ndarray:
    """(H, W, 3) uint8: panels, three in a row, of curves over logarithmic axes; a name has one colour in all."""
    names = sorted({name for curves in panels.values() for name in curves})
    colours = {name: _LINES[k % len(_LINES)] for k, name in enumerate(names)}
    width, height, margin = 380, 330, 56
    rows = -(-len(panels) // 3)
    image = Image.new("RGB", (width * min(3, len(panels)), rows * height + 60 + 18 * len(names)), "white")
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(_SIZE)
    draw.text((8, 6), title, fill="black", font=font)
    for k, (name, curves) in enumerate(panels.items()):
        x, y = k % 3 * width, k // 3 * height
        box = (x + margin, y + 54, x + width - 12, y + height - 16)
        draw.text((box[0], y + 32), name, fill="black", font=font)
        _log_chart(draw, font, box, {n: c for n, c in curves.items() if len(c)}, colours)
        draw.text((box[0] + 110, box[3] + 20), x_name, fill="black", font=font)
    for k, name in enumerate(names):
        y = rows * height + 46 + 18 * k
        draw.line((20, y + 8, 50, y + 8), fill=colours[name], width=3)
        draw.text((58, y), name, fill="black", font=font)
    return np.asarray(image)


def _range(values: Sequence[float]) -> tuple[float, float]:
    """The powers of ten, whole or not, between which an axis shows ``values``: one whole one at least lies there."""
    low, high = math.log10(min(values)) - 0.1, math.log10(max(values)) + 0.1
    return (low, high) if math.floor(high) >= math.ceil(low) else (math.floor(low), math.ceil(high))


def _log_chart(
    draw: ImageDraw.ImageDraw,
    font: Font,
    box: tuple[int, int, int, int],
    curves: Mapping[str, Curve],
    colours: Mapping[str, str],
) -> None:
    points = [p for curve in curves.values() for p in curve if p[0] > 0 and p[1] > 0]
    if not points:
        return
    (x0, x1), (y0, y1) = (_range([p[k] for p in points]) for k in (0, 1))
    left, top, right, bottom = box

    def place(x: float, y: float) -> tuple[float, float]:
        return left + (x - x0) / (x1 - x0) * (right - left), bottom - (y - y0) / (y1 - y0) * (bottom - top)

    for e in range(math.ceil(x0), math.floor(x1) + 1):
        x, _ = place(e, y0)
        draw.line((x, top, x, bottom), fill="#dddddd")
        draw.text((x - 10, bottom + 3), f"1e{e}", fill="black", font=font)
    for e in range(math.ceil(y0), math.floor(y1) + 1):
        _, y = place(x0, e)
        draw.line((left, y, right, y), fill="#dddddd")
        draw.text((left - 40, y - 8), f"1e{e}", fill="black", font=font)
    for name, curve in curves.items():
        placed = [place(math.log10(x), math.log10(y)) for x, y in curve if x > 0 and y > 0]
        draw.line(placed, fill=colours[name], width=2)
        for x, y in placed:
            draw.ellipse((x - 3, y - 3, x + 3, y + 3), fill=colours[name])
