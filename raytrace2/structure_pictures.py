"""Pictures of structures: their boxes by level over the image, and what each pixel's ray cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np

from .box_cuts import cut_pixels
from .box_edges import Projection, edge_pixels
from .picture_parts import Legend, caption, heat, heat_scale, stacked
from .rays.camera import make_camera
from .rays.ray import Ray
from .render import choose_camera
from .scene.description import Camera
from .scene.scene import Scene
from .surfaces.levels import Level
from .surfaces.structure import Structure

#: Colours of the levels drawn, the coarsest first.
_COLORS = np.array([[255, 255, 255], [255, 225, 80], [255, 140, 50], [240, 60, 110], [190, 90, 255], [70, 190, 255]])
#: Edges that cover more than this share of the image hide everything: only cuts through surfaces are drawn instead.
_MOST_EDGES = 0.15
#: Levels that still cover more than this, together with the dense ones above, show nothing: nor do those below.
_MOST_COVERED = 0.22
#: Nor does a level of more boxes than this.
_MOST_BOXES = 30_000


@dataclass(frozen=True, eq=False)
class LevelView:
    """A level in a picture: its number from the root (0), how many ``boxes`` it has and how many are ``seen``, and bool
    images (H, W) of where their edges are in ``front`` of surfaces or their sides cut them, and where edges are
    ``behind``. Of a ``dense`` level there are the cuts only, and only boxes that hold something visible are seen."""

    number: int
    boxes: int
    seen: int
    dense: bool
    front: np.ndarray
    behind: np.ndarray

    @property
    def covered(self) -> float:
        """The share of the image that the edges take."""
        return float((self.front | self.behind).mean())


@dataclass(frozen=True, eq=False)
class StructureView:
    """A structure seen through a camera: (H, W) images of ``shade`` (0 to 1), of ``nodes`` and volumes met and of
    ``primitives`` tested per ray; the ``levels`` drawn, coarsest first, and the picture ``boxes`` (H, W, 3) uint8."""

    name: str
    shade: np.ndarray
    nodes: np.ndarray
    volumes: np.ndarray
    primitives: np.ndarray
    levels: tuple[LevelView, ...]
    boxes: np.ndarray

    @property
    def cost(self) -> np.ndarray:
        """Nodes visited, and volumes and primitives tested, per ray."""
        return self.nodes + self.volumes + self.primitives


def view_structure(scene: Scene, accel: str, *, sensor: int = 0, size: tuple[int, int] | None = None) -> StructureView:
    """Builds the structure ``accel`` over ``scene`` and looks at it through camera ``sensor``, a ray a pixel."""
    return look_at(scene.traced(accel).structure, choose_camera(scene, sensor, size), accel)


def look_at(structure: Structure, camera: Camera, name: str) -> StructureView:
    """``structure`` through ``camera``, a ray through the middle of each pixel; ``name`` is its caption."""
    film = camera.film
    shape = (film.crop_height, film.crop_width)
    ray = _pixel_rays(camera, structure)
    hit, counts = structure.count(ray)
    si = structure.interact(ray, hit)
    facing = abs(dr.dot(si.sh_frame.n, ray.d))
    shade = np.array(dr.select(si.valid, 0.25 + 0.75 * facing, 0)).reshape(shape)
    projection = Projection.of(camera)
    points = np.array(si.p, np.float64).T.reshape(*shape, 3)
    depth = np.where(np.array(si.valid).reshape(shape), projection(points)[..., 3], np.inf)
    nodes, volumes, primitives = (
        np.array(c).reshape(shape).astype(np.int64) for c in (counts.nodes, counts.volumes, counts.primitives)
    )
    levels = tuple(_chosen(structure, projection, points, depth))
    return StructureView(name, shade, nodes, volumes, primitives, levels, _drawn(shade, levels))


def as_sheet(views: Sequence[StructureView]) -> np.ndarray:
    """The views side by side (H, W, 3) uint8: boxes above, costs as heat maps on one scale below."""
    greatest = max(1.0, *(float(np.percentile(view.cost, 99.8)) for view in views))
    width = views[0].shade.shape[1]
    legends = [[Legend(tuple(_COLORS[k]), _described(level)) for k, level in enumerate(view.levels)] for view in views]
    means = [
        f"{view.nodes.mean():.1f} nodes, {view.volumes.mean():.1f} volumes, {view.primitives.mean():.1f} primitives"
        f" a ray; at most {view.cost.max()}"
        for view in views
    ]
    rows = [
        caption([view.name for view in views], width),
        [view.boxes for view in views],
        caption(legends, width),
        [heat(view.cost / greatest) for view in views],
        caption(means, width),
    ]
    sheet = np.concatenate([stacked(column) for column in zip(*rows, strict=True)], axis=1)
    return np.concatenate([sheet, heat_scale(greatest, "nodes, volumes and primitives a ray", sheet.shape[1])])


def _described(level: LevelView) -> str:
    boxes = "box" if level.boxes == 1 else "boxes"
    where = "on visible surfaces (cuts alone drawn)" if level.dense else "in view"
    return f"level {level.number}: {level.boxes} {boxes}, {level.seen} {where}"


def _pixel_rays(camera: Camera, structure: Structure) -> Ray:
    """A ray through the middle of each pixel."""
    t, film = structure.types, camera.film
    index = dr.arange(t.UInt, film.crop_width * film.crop_height)
    y = index // film.crop_width
    x = index - y * film.crop_width
    position = t.Array2f((t.Float(x) + 0.5) / film.crop_width, (t.Float(y) + 0.5) / film.crop_height)
    return make_camera(camera, t).sample_ray(position, t.Array2f(0.5))


def _chosen(structure: Structure, projection: Projection, points: np.ndarray, depth: np.ndarray) -> list[LevelView]:
    """Levels that show something: of those that are in the view and leave most of it free, the first and the last and
    some between, evenly. The first below the root is among them whatever it covers,
    unless its boxes are more than can be told apart."""
    found: list[LevelView] = []
    for number, level in enumerate(structure.levels()):
        if len(level) > _MOST_BOXES:
            break
        view = _seen(number, level, projection, points, depth)
        if number > 1 and view.covered + sum(other.covered for other in found if other.dense) > _MOST_COVERED:
            break
        if view.covered > 0:
            found.append(view)
    if len(found) <= len(_COLORS):
        return found
    return [found[k] for k in np.linspace(0, len(found) - 1, len(_COLORS)).round().astype(int)]


def _seen(number: int, level: Level, projection: Projection, points: np.ndarray, depth: np.ndarray) -> LevelView:
    """A level as it is drawn: without edges where they would hide everything."""
    front, behind, edged = edge_pixels(projection, level.lo, level.hi, depth)
    cut, held = cut_pixels(projection, level.lo, level.hi, points, depth)
    dense = bool((front | behind).mean() > _MOST_EDGES and cut.any())
    seen = int(np.count_nonzero(held if dense else edged | held))
    if dense:
        return LevelView(number, len(level), seen, dense, cut, np.zeros_like(cut))
    return LevelView(number, len(level), seen, dense, front | cut, behind & ~cut)


def _drawn(shade: np.ndarray, levels: Sequence[LevelView]) -> np.ndarray:
    """The levels over the shaded image, the coarsest on top; what is behind surfaces shines through."""
    picture = np.repeat(shade[..., None] * 130.0, 3, axis=2)
    for k in range(len(levels) - 1, -1, -1):
        behind = levels[k].behind
        picture[behind] = 0.7 * picture[behind] + 0.3 * _COLORS[k]
    for k in range(len(levels) - 1, -1, -1):
        picture[levels[k].front] = _COLORS[k]
    return picture.astype(np.uint8)
