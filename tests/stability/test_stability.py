"""The scoreboard of extremes: its judges judge rightly, its records are kept, its table and picture show them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from raytrace2 import cli
from raytrace2.errors import SettingError
from raytrace2.stability import exact, scoreboard, trade
from raytrace2.stability.extreme_cases import Case
from raytrace2.stability.meshes import icosphere, spiky
from raytrace2.stability.picture import picture
from raytrace2.stability.rays import batches
from raytrace2.stability.sweep import Counts
from raytrace2.stability.table import markdown, per_million
from raytrace2.stability.times import boxes_met
from raytrace2.stability.tracers import Ours
from raytrace2.surfaces.mesh import TriangleMesh

SMALL = Counts(aimed=3000, random=3000, other=2048, scale_step=60, levels=2, identical=100, longest=0.02)


@pytest.mark.parametrize("shift", [0.0, 1e6])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_the_quick_judge_agrees_with_rational_numbers(dtype: str, shift: float) -> None:
    closed = spiky(1, dtype).placed(1, shift)
    for target in ("vertex", "edge"):
        rays = next(batches(closed, target, "inside", 40, 1))
        assert rays.near is not None
        slow = [
            any(exact.exactly_meets(closed.vertices[f], o, d) for f in closed.faces[near])
            for o, d, near in zip(rays.o, rays.d.astype(float), rays.near, strict=True)
        ]
        assert exact.really_meets(closed.vertices, closed.faces[rays.near], rays.o, rays.d).tolist() == slow
        assert all(exact.meets_mesh(closed.vertices, closed.faces, rays.o[k], rays.d[k]) for k in range(5))


def test_only_who_is_missing_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    measured = scoreboard._measured

    def noting(figure: scoreboard.Figure, precision: str, counts: Counts, tracers: list) -> dict:
        asked.extend(t.name for t in tracers)
        return measured(figure, precision, counts, tracers)

    monkeypatch.setattr(scoreboard, "_measured", noting)
    found, _ = scoreboard.run(["bvh"], SMALL, tmp_path, ["edge_outside"])
    assert asked == ["bvh", "Embree default", "Embree robust", "bvh"]
    asked.clear()
    more, _ = scoreboard.run(["bvh", "grid"], SMALL, tmp_path, ["edge_outside"])
    assert asked == ["grid", "grid"]
    assert list(more["edge_outside", "float32"]) == ["bvh", "grid", "Embree default", "Embree robust"]
    asked.clear()
    again, _ = scoreboard.run(["bvh"], SMALL, tmp_path, ["edge_outside"])
    assert asked == []
    assert again == found
    assert (
        found["edge_outside", "float32"]["bvh"]["value"] == 0 and more["edge_outside", "float64"]["grid"]["value"] == 0
    )
    with pytest.raises(SettingError, match="no figure is called so"):
        scoreboard.run(["bvh"], SMALL, tmp_path, ["nonsense"])


def test_the_trade_takes_each_safety_away_alone() -> None:
    assert len(trade.ways("bvh")) == len(trade.ways("bvh:width=8")) == 8
    assert len(trade.ways("kdtree")) == len(trade.ways("bvh:volume=sphere")) == 4
    counts = Counts(aimed=5000, random=5000, other=2048, levels=3, longest=10)
    found = trade.measure("bvh", counts)
    for precision in ("float32", "float64"):
        safe, fast = (found[f"{precision}, {i}, padded"] for i in ("watertight", "fast"))
        assert safe["vertex"] == safe["edge"] == safe["far"] == 0
        assert fast["vertex"] > 100 and fast["edge"] > 100
        assert 0 < safe["t"] < 2e-7 and safe["rays"] == 5000
    assert found["float32, watertight, bare"]["far"] > 0
    table = markdown({}, {"bvh": found}, counts)
    assert "| bvh | float32 | watertight | bare |" in table and "| bvh | float64 | fast | padded |" in table
    image = picture({}, {"bvh": found})
    assert image.dtype == np.uint8 and image.shape[2] == 3 and image.std() > 10


def test_counts_are_told_of_a_million() -> None:
    assert [per_million(*x) for x in ((0, 5), (1, 2_000_000), (3, 4000))] == ["0", "0.5", "750"]


def test_boxes_on_the_way_are_counted() -> None:
    steps = np.arange(1.0, 6.0)
    corners = np.array([[0, -1, -1], [0, 1, -1], [0, 0, 1.0]])
    mesh = TriangleMesh(
        np.concatenate([corners + [s, 0, 0] for s in steps[::-1]]), np.arange(3 * len(steps)).reshape(-1, 3)
    )
    scene = Ours("bvh", "float64").load([mesh])
    o = np.array([[2.5, 0, 0], [0, 0.9, 0.9], [0, 5, 0], [0, 0, 0]])
    d = np.array([[1.0, 0, 0], [1, 0, 0], [1, 0, 0], [np.nan, 0, 0]])
    # One triangle; five that are passed within their boxes; none; no ray.
    assert boxes_met(scene, Case((mesh,), o, d)) == (1 + 5 + 0 + 0) / 4


def test_extreme_cases_and_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stability", "--rays", "2048", "--only", "ended", "--accel", "bvh", "-o", str(tmp_path)]
    assert cli.main(words) == 0
    assert "occluded against intersect" in capsys.readouterr().out
    assert (tmp_path / "stability.md").exists() and (tmp_path / "stability.png").stat().st_size > 1000
    assert cli.main(["stability", "--accel", "octree", "-o", str(tmp_path)]) == 2
    found, _ = scoreboard.run(["bvh"], SMALL, tmp_path, ["times"])
    record = found["times", "float32"]["bvh"]
    assert record["cases"].keys() == record["builds"].keys() == record["met"].keys()
    assert record["met"]["scale 2^-60"] == 1
    table = markdown(found, {}, SMALL)
    assert "| one centroid for all |" in table
    assert icosphere(2, "float32").faces.shape == (320, 3)
