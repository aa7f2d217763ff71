"""What a frame costs by the number of its rays: update and rays x time of a ray; who is cheapest, and from where on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from animation_updates import ADAPTIVE, KINDS, NORMAL, REFIT, STRATEGIES, Record, mean
from study import markdown_table

#: Rays per frame in tables and pictures.
POWERS = range(3, 9)

#: Seconds of an update, and of a ray.
Line = tuple[float, float]

Frames = Mapping[str, Sequence[Record]]


def lines(records: Sequence[Record], kind: str) -> dict[str, Line]:
    """The means over the frames of each strategy that is one of its own: one that never built is the refit, and one
    that built in every frame is the build and a refit in vain."""
    built = sum(r["strategies"][ADAPTIVE]["rebuilt"] for r in records)
    chosen = [s for s in STRATEGIES if s != ADAPTIVE or 0 < built < len(records)]
    return {s: (mean(records, s, "update"), mean(records, s, "seconds", kind)) for s in chosen}


def cost(line: Line, rays: float) -> float:
    """Seconds of a frame."""
    return line[0] + rays * line[1]


def crossover(a: Line, b: Line) -> float:
    """The number of rays at which ``a`` and ``b`` cost the same; infinite if one is never dearer."""
    update, ray = a[0] - b[0], b[1] - a[1]
    return update / ray if update * ray > 0 else math.inf


def cheapest(of: Mapping[str, Line]) -> list[tuple[float, str]]:
    """From how many rays on which strategy is cheapest, up to any number of rays."""
    name = min(of, key=lambda n: of[n])
    found = [(0.0, name)]
    while faster := [n for n in of if of[n][1] < of[name][1]]:
        at, _, name = min((crossover(of[name], of[n]), of[n][1], n) for n in faster)
        found.append((at, name))
    return found


def winner_table(animations: Frames) -> str:
    """Who is cheapest at each power of ten, and by how much; then where one winner hands over to the next."""
    head = ["animation", "rays", *(f"10^{k} rays" for k in POWERS), "handed over"]
    rows = []
    for name, records in animations.items():
        for kind in KINDS:
            of = lines(records, kind)
            cells = []
            for k in POWERS:
                first, second = sorted(of, key=lambda n, k=k: cost(of[n], 10.0**k))[:2]
                factor = cost(of[second], 10.0**k) / cost(of[first], 10.0**k)
                cells.append(f"{first} ({factor:.2f} {second})")
            turns = "; ".join(f"{n} from {at:.1e}" for at, n in cheapest(of)[1:]) or "never"
            rows.append([name, kind, *cells, turns])
    return markdown_table(head, rows)


def crossover_table(animations: Frames) -> str:
    """For each pair the cheaper one below and above the number of rays at which they cost the same."""
    pairs = [(a, b) for i, a in enumerate(STRATEGIES) for b in STRATEGIES[i + 1 :]]
    rows = []
    for pair in pairs:
        cells = []
        for records in animations.values():
            for kind in KINDS:
                of = lines(records, kind)
                if not of.keys() >= set(pair):
                    cells.append("")
                    continue
                low, high = sorted(pair, key=lambda n, of=of: of[n])
                at = crossover(of[low], of[high])
                cells.append(f"always {low}" if math.isinf(at) else f"{low} < {at:.1e} < {high}")
        rows.append([" and ".join(pair), *cells])
    return markdown_table(["pair", *(f"{name}, {kind}" for name in animations for kind in KINDS)], rows)


def strategy_table(animations: Frames) -> str:
    """Means over the frames of each strategy."""
    head = ["animation", "strategy", "update, ms", "faster than sah", "primary, Mrays/s", "bounce, Mrays/s", "rebuilt",
            "largest ratio", "rays compared", "differing"]  # fmt: skip
    rows = []
    for name, records in animations.items():
        normal = mean(records, NORMAL, "update")
        for s in STRATEGIES:
            update = mean(records, s, "update")
            rates = [f"{1e-6 / mean(records, s, 'seconds', kind):.2f}" for kind in KINDS]
            found = [r["strategies"][s] for r in records]
            rebuilt = f"{sum(f['rebuilt'] for f in found)} of {len(found)}"
            ratios = [f["ratio"] for f in found if f["ratio"] is not None]
            rays = sum(r["rays"][kind]["count"] for r in records for kind in KINDS)
            rows.append([
                name, s, f"{update * 1e3:.1f}", f"{normal / update:.1f}", *rates, rebuilt,
                f"{max(ratios):.2f}" if ratios else "", f"{rays:,}", str(sum(f["differing"] for f in found)),
            ])  # fmt: skip
    return markdown_table(head, rows)


def refit_table(animations: Frames) -> str:
    """How much faster a refit is than the build, and how much slower the rays through it at worst."""
    head = ["animation", "first refit of a tree, ms", "later refits, ms", "sah build, ms", "build / first refit",
            "build / later refits", "largest reported ratio", "to a new tree", "bounce's seconds"]  # fmt: skip
    rows = []
    for name, records in animations.items():
        refits = [r["strategies"][REFIT]["update"] * 1e3 for r in records]
        build = mean(records, NORMAL, "update") * 1e3
        # Of a resumed or short animation there may be no frame but the first.
        first, later = refits[0], float(np.mean(refits[1:] or refits))
        worst = max(records, key=lambda r: r["strategies"][REFIT]["ratio"])
        rows.append([
            name, f"{first:.1f}", f"{later:.1f}", f"{build:.1f}", f"{build / first:.1f}", f"{build / later:.1f}",
            f"{worst['strategies'][REFIT]['ratio']:.2f}", f"{fresh_ratio(worst):.2f}", f"{slowdown(worst):.2f}",
        ])  # fmt: skip
    return markdown_table(head, rows)


def slowdown(record: Record) -> float:
    """How much longer a bounce takes in the refitted tree than in one built for the frame."""
    of = record["strategies"]
    return of[REFIT]["seconds"]["bounce"] / of[NORMAL]["seconds"]["bounce"]


def fresh_ratio(record: Record) -> float:
    """The expected cost in the refitted tree over that in one built for the frame."""
    return record["strategies"][REFIT]["sah_cost"] / record["strategies"][NORMAL]["sah_cost"]


def frame_table(records: Sequence[Record]) -> str:
    """Each frame: the ratios, the rays from which building pays in this frame, and each strategy's figures."""
    head = ["frame", "reported ratio", "to a rebuilt tree", "bounce's seconds to those", "sah pays from, bounces",
            f"{ADAPTIVE}: ratio", *STRATEGIES]  # fmt: skip
    rows = []
    for r in records:
        of = r["strategies"]
        line = {s: (of[s]["update"], of[s]["seconds"]["bounce"]) for s in (REFIT, NORMAL)}
        pays = crossover(line[REFIT], line[NORMAL])
        cells = [
            " / ".join([f"{of[s]['update'] * 1e3:.1f}", *(f"{1e-6 / of[s]['seconds'][k]:.2f}" for k in KINDS)])
            for s in STRATEGIES
        ]
        adaptive = "rebuilt" if of[ADAPTIVE]["ratio"] is None else f"{of[ADAPTIVE]['ratio']:.2f}"
        rows.append([
            str(r["frame"]), f"{of[REFIT]['ratio']:.2f}", f"{fresh_ratio(r):.2f}", f"{slowdown(r):.2f}",
            "never" if math.isinf(pays) else f"{pays:.1e}", adaptive, *cells,
        ])  # fmt: skip
    return markdown_table(head, rows)
