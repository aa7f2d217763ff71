"""The picture of the animations: cost against rays, and quality over frames."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from animation_costs import KINDS, POWERS, Frames, cost, fresh_ratio, lines, slowdown
from animation_updates import ADAPTIVE, REFIT, Record
from charts import Curve, log_charts
from PIL import Image, ImageDraw, ImageFont

_SIZE = 13
_PANEL = (380, 330)
_LINES = ("#1f77b4", "#2ca02c", "#d62728", "#ff7f0e")


def picture(animations: Frames, title: str) -> np.ndarray:
    """(H, W, 3) uint8: a row of panels of seconds, two of how far from the cheapest, one of quality."""
    panels: dict[str, dict[str, Curve]] = {}
    rays = np.logspace(POWERS[0], POWERS[-1], 4 * (len(POWERS) - 1) + 1)
    for name, records in animations.items():
        of = lines(records, "bounce")
        panels[f"{name}: ms per frame, bounces"] = {s: [(r, cost(of[s], r) * 1e3) for r in rays] for s in of}
    for kind in reversed(KINDS):
        for name, records in animations.items():
            of = lines(records, kind)
            least = {r: min(cost(line, r) for line in of.values()) for r in rays}
            panels[f"{name}: cost over the least, {kind}"] = {
                s: [(r, cost(of[s], r) / least[r]) for r in rays] for s in of
            }
    upper = log_charts(title, panels, "rays per frame")
    lower = frame_charts({name: quality(records) for name, records in animations.items()})
    width = max(upper.shape[1], lower.shape[1])
    parts = [np.pad(p, ((0, 0), (0, width - p.shape[1]), (0, 0)), constant_values=255) for p in (upper, lower)]
    return np.concatenate(parts)


def quality(records: Sequence[Record]) -> dict[str, Curve]:
    """What a refit reports and what it should have told, by frame."""
    frames = [r["frame"] for r in records]
    adaptive = [r["strategies"][ADAPTIVE]["ratio"] or 1.0 for r in records]
    reported = [r["strategies"][REFIT]["ratio"] for r in records]
    found = {
        "refit: the ratio that it reports (expected cost now to that when built)": reported,
        f"{ADAPTIVE}: the same (1 where built anew)": adaptive,
        "refit: expected cost to that of a tree built for the frame": [fresh_ratio(r) for r in records],
        "refit: measured seconds of a bounce to those in a tree built for the frame": [slowdown(r) for r in records],
    }
    return {name: list(zip(frames, values, strict=True)) for name, values in found.items()}


def frame_charts(panels: Mapping[str, Mapping[str, Curve]]) -> np.ndarray:
    """(H, W, 3) uint8: a panel for each animation, ratios on a logarithmic axis over frames on a linear one."""
    names = list(next(iter(panels.values())))
    colours = dict(zip(names, _LINES, strict=True))
    width, height = _PANEL
    image = Image.new("RGB", (width * len(panels), height + 40 + 18 * len(names)), "white")
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(_SIZE)
    for k, (title, curves) in enumerate(panels.items()):
        box = (k * width + 56, 34, (k + 1) * width - 12, height - 16)
        draw.text((box[0], 12), f"{title}: quality by frame", fill="black", font=font)
        _panel(draw, font, box, curves, colours)
        draw.text((box[0] + 130, box[3] + 20), "frame", fill="black", font=font)
    for k, name in enumerate(names):
        y = height + 30 + 18 * k
        draw.line((20, y + 8, 50, y + 8), fill=colours[name], width=3)
        draw.text((58, y), name, fill="black", font=font)
    return np.asarray(image)


def _panel(
    draw: ImageDraw.ImageDraw,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
    box: tuple[int, int, int, int],
    curves: Mapping[str, Curve],
    colours: Mapping[str, str],
) -> None:
    left, top, right, bottom = box
    points = [p for curve in curves.values() for p in curve]
    last = max(p[0] for p in points)
    low, high = min(0.9, *(p[1] for p in points)) * 0.95, max(1.2, *(p[1] for p in points)) * 1.05

    def place(frame: float, value: float) -> tuple[float, float]:
        up = math.log(value / low) / math.log(high / low)
        return left + frame / max(last, 1) * (right - left), bottom - up * (bottom - top)

    for frame in range(0, int(last) + 1, max(1, round(last / 6))):
        x, _ = place(frame, 1.0)
        draw.line((x, top, x, bottom), fill="#dddddd")
        draw.text((x - 6, bottom + 3), str(frame), fill="black", font=font)
    for value in _ticks(low, high):
        _, y = place(0, value)
        draw.line((left, y, right, y), fill="#dddddd")
        text = f"{value:g}"
        draw.text((left - 6 - font.getlength(text), y - 8), text, fill="black", font=font)
    for name, curve in curves.items():
        placed = [place(*p) for p in curve]
        draw.line(placed, fill=colours[name], width=2)
        for x, y in placed:
            draw.ellipse((x - 3, y - 3, x + 3, y + 3), fill=colours[name])


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers from ``low`` to ``high``, finer where the range is small."""
    digits = (1.0, 1.05, 1.1, 1.15, 1.2, 1.3, 1.4, 9.0, 9.5) if high < 1.6 * low else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
    every = [d * 10.0**e for e in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1) for d in digits]
    return [v for v in every if low <= v <= high]
