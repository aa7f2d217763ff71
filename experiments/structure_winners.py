"""Who wins on which scene and why: the rules by which measured structures are compared, and the tables that say it."""

from __future__ import annotations

import math
from typing import Any

from structure_speed import RAY_KINDS
from study import markdown_table

Record = dict[str, Any]

#: Rates nearer than this are not told apart.
TIE = 1.05

#: Columns of the table of winners.
WINNER_HEAD = ["scene", "primary", "bounce", "shadow", "build", "why (bounce)"]


def relative(record: Record, kind: str) -> float:
    """The rate over that of the default hierarchy, which took turns with it."""
    speed = record["rays"][kind]
    return speed["rate"] / speed["normal"]


def steps(record: Record, kind: str) -> float:
    """Turns of a ray's loop: nodes and cells (whose volumes are tested at once; volumes in lists) and primitives."""
    speed = record["rays"][kind]
    return (speed["nodes"] or speed["volumes"]) + speed["primitives"]


def ranked(records: list[Record], kind: str) -> list[Record]:
    """The fastest first."""
    return sorted(records, key=lambda r: -relative(r, kind))


def winner(records: list[Record], kind: str) -> tuple[Record, Record | None]:
    """The fastest, and the fastest of another kind of structure."""
    order = ranked(records, kind)
    others = [r for r in order if r["kind"] != order[0]["kind"]]
    return order[0], others[0] if others else None


def reason(records: list[Record], kind: str) -> str:
    """Why the winner is faster than the best of another kind: time is steps x time of a step, and the factor that tells
    them apart more is the reason."""
    first, second = winner(records, kind)
    if second is None:
        return "alone"
    faster = relative(first, kind) / relative(second, kind)
    if faster < TIE:
        return f"tie with {short(second)}"
    mine, other = steps(first, kind), steps(second, kind)
    fewer = other / max(mine, 1e-9)
    cheaper = faster / fewer
    against = f"{mine:.3g} against {other:.3g} of {short(second)}"
    if fewer > 1 and math.log(fewer) >= math.log(faster) / 2:
        least = min(steps(r, kind) for r in records)
        return ("fewest" if mine <= least else "fewer") + f" nodes + primitives: {against}"
    more = " for more" if fewer < 1 / TIE else ""
    return f"cheaper steps{more}: {against}, each in {1 / cheaper:.2f} of the time"


def build_winner(records: list[Record]) -> Record:
    """The quickest to build of those that are at least half as fast as the fastest on bounces."""
    fastest = relative(ranked(records, "bounce")[0], "bounce")
    return min((r for r in records if relative(r, "bounce") >= fastest / 2), key=lambda r: r["build_seconds"])


def short(record: Record) -> str:
    """A structure's name as tables show it: options that are words go without their names."""
    kind, _, settings = record["structure"].partition(":")
    words = []
    for setting in filter(None, settings.split(",")):
        key, _, value = setting.partition("=")
        words.append(f"{key} {value}" if value[0].isdigit() else value)
    return " ".join([kind, *words])


def winner_table(scenes: dict[str, list[Record]]) -> str:
    """One line for each scene: who wins on each kind of ray and by how much, who is quickest to build, and why."""
    lines = []
    for scene, records in scenes.items():
        cells = []
        for kind in RAY_KINDS:
            first, second = winner(records, kind)
            lead = "" if second is None else f" ({relative(first, kind) / relative(second, kind):.2f}x)"
            cells.append(short(first) + lead)
        quick = build_winner(records)
        build = f"{short(quick)} ({quick['build_seconds']:.2g} s)"
        lines.append([scene, *cells, build, reason(records, "bounce")])
    return markdown_table(WINNER_HEAD, lines)


SCENE_HEAD = ["structure", "build, s", "MB", *(f"{k}, Mrays/s" for k in RAY_KINDS),
              *(f"{k} / bvh" for k in RAY_KINDS), *(f"{k} / Embree" for k in RAY_KINDS),
              "volumes", "nodes", "primitives", "expected", "duplication"]  # fmt: skip


def scene_table(records: list[Record]) -> str:
    """Everything that was measured on one scene, the fastest on bounces first; counters are those of bounces."""
    return markdown_table(SCENE_HEAD, [_line(r) for r in ranked(records, "bounce")])


def reasons(records: list[Record]) -> str:
    """Why each kind of ray has the winner that it has."""
    lines = [f"- {kind}: {short(winner(records, kind)[0])}, {reason(records, kind)}\n" for kind in RAY_KINDS]
    return "".join(lines)


def _line(record: Record) -> list[str]:
    speeds = [record["rays"][kind] for kind in RAY_KINDS]
    theirs = ["" if s["mitsuba"] is None else f"{s['rate'] / s['mitsuba']:.2f}" for s in speeds]
    bounce, said = record["rays"]["bounce"], record["statistics"]
    expected = [f"{said[k]:.3g} {k.removeprefix('expected_').replace('_', ' ')}" for k in said if "expected" in k]
    return [
        short(record), f"{record['build_seconds']:.3f}", f"{said['bytes'] / 1e6:.1f}",
        *(f"{s['rate'] / 1e6:.3g}" for s in speeds), *(f"{relative(record, k):.2f}" for k in RAY_KINDS), *theirs,
        *(f"{bounce[k]:.1f}" for k in ("volumes", "nodes", "primitives")),
        ", ".join(expected) or (f"cost {said['sah_cost']:.3g}" if "sah_cost" in said else ""),
        f"{said['duplication']:.2f}" if "duplication" in said else "1.00",
    ]  # fmt: skip
