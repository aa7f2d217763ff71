"""The scoreboard as Markdown: in short, by structure, the trade, and the times of extreme cases."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .extreme_cases import OTHER_SCENES
from .figures import FIGURES, figure
from .scoreboard import Found, Traded
from .sweep import Counts, Record, disagree

OTHERS = ("Embree default", "Embree robust")


def markdown(found: Found, traded: Traded, counts: Counts, broken: dict[str, Any] | None = None) -> str:
    """All tables, in sections; ``broken`` fills the row of broken files."""
    text = f"# Numerical stability\n\n## Scoreboard\n\n{_about(counts)}\n\n{scoreboard(found, broken)}\n"
    for precision in ("float32", "float64"):
        table = by_structure(found, precision)
        if table:
            text += f"## By structure, {precision}\n\nIn brackets: million rays per second, and the rays if fewer than "
            text += f"the others'.\n\n{table}\n"
    if traded:
        text += (
            "## The trade\n\nWhat each safety costs, and what goes wrong without it: precision, the watertight or the "
        )
        text += "fast test of triangles, and the margins for rounding by which boxes are widened ('bare': "
        text += "without, which only a bvh can be). Rays per second are of random rays inside the "
        text += f"icosphere, all ways in turn.\n\n{trade_table(traded)}\n"
    times = {p: found["times", p] for p in ("float32", "float64") if ("times", p) in found}
    if times:
        text += "## Extreme cases\n\nTime of a ray over that in a benign scene of as many triangles: the icosphere for "
        text += "what scales, moves or deforms it and for odd rays, random triangles of which rays meet some for "
        text += f"{', '.join(OTHER_SCENES)} (in brackets: the same of the time of the build). 'boxes met': the "
        text += "triangles whose boxes a ray meets before it ends, over those in the benign scene.\n\n"
        text += time_table(times)
    return text


def _about(c: Counts) -> str:
    return (
        f"Closed meshes of {20 * 4**c.levels:,} faces; {c.aimed:,} rays at vertices and edges, {c.random:,} random, "
        f"{c.other:,} of other kinds; a structure that needs more than {c.longest:g} s for a figure gets fewer (but "
        f"the bvh in float32, and Embree, all those that may leak). Leaks "
        f"are settled in exact arithmetic. 'ours' is the worst of all structures; 'agree': all structures give the "
        f"same bits of t, primitive and barycentrics on the rays that they share."
    )


def scoreboard(found: Found, broken: dict[str, Any] | None = None) -> str:
    """One row a figure: Mitsuba with Embree, default and robust, and the worst of our structures."""
    rows = []
    for f in FIGURES:
        narrow, wide = found.get((f.key, "float32"), {}), found.get((f.key, "float64"), {})
        if not narrow and not wide:
            continue
        cells = [f.title, *(_value(f.key, narrow[n], True) if n in narrow else "" for n in OTHERS)]
        agree = []
        for precision, records in (("float32", narrow), ("float64", wide)):
            ours = _ours(records)
            worst = max(ours.values(), key=lambda r: _size(r["value"]), default=None)
            cells.append("" if worst is None else _marked(f.key, worst, precision))
            if all("few" in r for r in ours.values()) and f.key != "gaps":
                agree += disagree(ours)
        cells += [f.wanted, "no: " + ", ".join(sorted(set(agree))) if agree else "yes"]
        rows.append(cells)
    said = broken or {}
    rows.append(
        [
            "broken files; ply with four bytes changed: process kills",
            said.get("Embree default", "—"),
            "",
            said.get("ours", "—"),
            "",
            "0; 0",
            "",
        ]
    )
    head = ["figure", *OTHERS, "ours, float32", "ours, float64", "wanted", "agree"]
    return _table(head, rows)


def by_structure(found: Found, precision: str) -> str:
    """One row a figure, one column a structure."""
    kept = [(f, found[f.key, precision]) for f in FIGURES if (f.key, precision) in found]
    if not kept:
        return ""
    names = list(dict.fromkeys(n for _, records in kept for n in records))
    rows = []
    for f, records in kept:
        most = max(r["rays"] for r in records.values())
        cells = [f.title]
        for name in names:
            record = records.get(name)
            if record is None:
                cells.append("")
                continue
            fewer = "" if record["rays"] == most else f", {record['rays']:,} rays"
            cells.append(f"{_value(f.key, record)} ({record['rate'] / 1e6:.2g}{fewer})")
        rows.append(cells)
    return _table(["figure", *names], rows)


def trade_table(traded: Traded) -> str:
    """What each safety costs in rays per second, and what goes wrong without it, by structure and way."""
    head = ["structure", "precision", "test of triangles", "boxes", "Mrays/s", "of the safest in float32"]
    head += ["leaks per 10^6: vertices", "edges", "edges at translation 10^6", "worst relative error of t", "rays"]
    rows = []
    for kind, records in traded.items():
        first = next(iter(records.values()))
        for way, record in records.items():
            leaks = [per_million(record[key], record["rays"]) for key in ("vertex", "edge", "far")]
            rows.append([
                kind, *way.split(", "), f"{record['rate'] / 1e6:.2g}", f"{record['rate'] / first['rate']:.2f}",
                *leaks, f"{record['t']:.2g}", f"{record['rays']:,}",
            ])  # fmt: skip
    return _table(head, rows)


def per_million(count: int, rays: int) -> str:
    """A count in so many rays as one in a million."""
    share = count / rays * 1e6
    return f"{share:,.0f}" if share >= 1 or not count else f"{share:.1g}"


def time_table(times: dict[str, dict[str, Record]]) -> str:
    """One row an extreme case, one column a structure and precision."""
    columns = [(p, n) for p, records in times.items() for n in records]
    cases = list(dict.fromkeys(c for p, n in columns for c in times[p][n]["cases"]))
    rows = []
    for case in cases:
        p, n = columns[0]
        cells = [case, f"{times[p][n]['met'][case]:.2g}"]
        for p, n in columns:
            record = times[p][n]
            cells.append(f"{record['cases'][case]:.2g} ({record['builds'][case]:.2g})")
        rows.append(cells)
    return _table(["case", "boxes met", *(f"{n} {p.removeprefix('float')}" for p, n in columns)], rows)


def _ours(records: dict[str, Record]) -> dict[str, Record]:
    return {n: r for n, r in records.items() if n not in OTHERS}


def _marked(key: str, record: Record, precision: str) -> str:
    text = _value(key, record, True)
    return text if figure(key).good(_size(record["value"]), precision) else f"**{text}**"


def _size(value: float | None) -> float:
    return math.inf if value is None or math.isnan(value) else value


def _value(key: str, record: Record, with_rays: bool = False) -> str:
    value = record["value"]
    text = f"{value:,}" if isinstance(value, int) else ("none" if _size(value) == math.inf else f"{value:.2g}")
    if isinstance(value, int) and with_rays and value:
        text += f" of {record['rays']:,}"
    if key == "scales":
        low, high = record["low"], record["high"]
        text += "; misses at every scale" if low is None else f"; none missed from 2^{low} to 2^{high}"
    if "self_hits" in record:
        text += f"; {record['self_hits']:,} self-hits"
    return text


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(str(c) for c in line) + " |\n" for line in lines)
