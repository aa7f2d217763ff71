"""Pictures of structures: their boxes by level over the image, and what each pixel's ray cost."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from PIL import Image, ImageDraw

from .rays.camera import make_camera
from .rays.ray import Ray
from .render import choose_camera
from .scene.description import PerspectiveCamera
from .scene.scene import Scene
from .surfaces.structure import Structure

#: Colours of levels, root first: from light to dark along one scale, so that depth reads as such.
_LEVELS = np.array([[255, 255, 255], [255, 214, 102], [255, 145, 77], [226, 74, 96], [150, 40, 120], [80, 30, 110]])
#: The heat map's stops: no cost black, the greatest white.
_HEAT = np.array([[0, 0, 4], [60, 15, 110], [150, 45, 128], [230, 80, 95], [254, 160, 110], [252, 253, 191]])


@dataclass(frozen=True, eq=False)
class StructureView:
    """A structure seen through a camera: (H, W) images of ``shade`` (0 to 1), of ``nodes`` and volumes met and of
    ``primitives`` tested per ray, and the picture with its boxes ``boxes`` (H, W, 3) uint8."""

    name: str
    shade: np.ndarray
    nodes: np.ndarray
    volumes: np.ndarray
    primitives: np.ndarray
    boxes: np.ndarray

    @property
    def cost(self) -> np.ndarray:
        """Nodes visited, and volumes and primitives tested, per ray."""
        return self.nodes + self.volumes + self.primitives


def view_structure(scene: Scene, accel: str, *, sensor: int = 0, size: tuple[int, int] | None = None) -> StructureView:
    """Builds the structure ``accel`` over ``scene`` and looks at it through camera ``sensor``, a ray a pixel."""
    structure = scene.traced(accel).structure
    camera = choose_camera(scene, sensor, size)
    film = camera.film
    ray = _pixel_rays(camera, structure)
    hit, counts = structure.count(ray)
    si = structure.interact(ray, hit)
    shape = (film.crop_height, film.crop_width)
    facing = abs(dr.dot(si.sh_frame.n, ray.d))
    shade = np.array(dr.select(si.valid, 0.25 + 0.75 * facing, 0)).reshape(shape)
    nodes, volumes, primitives = (
        np.array(c).reshape(shape).astype(np.int64) for c in (counts.nodes, counts.volumes, counts.primitives)
    )
    picture = Image.fromarray(np.repeat((shade * 150)[..., None], 3, axis=2).astype(np.uint8))
    if isinstance(camera, PerspectiveCamera):
        _draw_boxes(picture, camera, structure)
    return StructureView(accel, shade, nodes, volumes, primitives, np.asarray(picture))


def as_sheet(views: Sequence[StructureView]) -> np.ndarray:
    """The views side by side (H, W, 3) uint8: boxes above, costs as heat maps on one scale below."""
    greatest = max(float(np.percentile(view.cost, 99.8)) for view in views)
    columns = []
    for view in views:
        heat = _heat(view.cost / max(greatest, 1))
        means = (view.nodes.mean(), view.volumes.mean(), view.primitives.mean())
        caption = f"{view.name}: {means[0]:.1f} nodes, {means[1]:.1f} volumes, {means[2]:.1f} primitives"
        columns.append(np.concatenate([_caption(caption, heat.shape[1]), view.boxes, heat], axis=0))
    sheet = np.concatenate(columns, axis=1)
    footer = _caption(f"below: all of these per ray, black 0 to white {greatest:.0f}", sheet.shape[1])
    return np.concatenate([sheet, footer], axis=0)


def _pixel_rays(camera: Any, structure: Structure) -> Ray:
    """A ray through the middle of each pixel."""
    t, film = structure.types, camera.film
    index = dr.arange(t.UInt, film.crop_width * film.crop_height)
    y = index // film.crop_width
    x = index - y * film.crop_width
    position = t.Array2f((t.Float(x) + 0.5) / film.crop_width, (t.Float(y) + 0.5) / film.crop_height)
    return make_camera(camera, t).sample_ray(position, t.Array2f(0.5))


def _draw_boxes(picture: Image.Image, camera: PerspectiveCamera, structure: Structure) -> None:
    """Draws the edges of the first levels' boxes, finest first."""
    draw = ImageDraw.Draw(picture)
    levels = structure.level_bounds()[: len(_LEVELS)]
    corners = np.array(list(itertools.product((0, 1), repeat=3)))
    edges = [(a, b) for a, b in itertools.combinations(range(8), 2) if np.abs(corners[a] - corners[b]).sum() == 1]
    for level in range(len(levels) - 1, -1, -1):
        lo, hi = levels[level]
        color = tuple(int(c) for c in _LEVELS[level])
        points = np.where(corners[None] == 0, lo[:, None], hi[:, None])
        for box in points:
            for a, b in edges:
                line = _projected(camera, box[a], box[b])
                if line is not None:
                    draw.line(line, fill=color, width=1)


def _projected(camera: PerspectiveCamera, a: np.ndarray, b: np.ndarray) -> list[tuple[float, float]] | None:
    """The pixels of both ends of a world-space segment, cut at the near plane; None behind it."""
    world_to_camera = np.linalg.inv(np.asarray(camera.to_world, dtype=np.float64))
    p = np.stack([a, b]).astype(np.float64) @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    near = camera.near_clip
    if (p[:, 2] < near).all():
        return None
    for i, j in ((0, 1), (1, 0)):
        if p[i, 2] < near:
            p[i] += (p[j] - p[i]) * (near - p[i, 2]) / (p[j, 2] - p[i, 2])
    film = camera.film
    half = np.tan(np.radians(camera.x_fov) / 2)
    x = (0.5 - camera.principal_point_offset_x - p[:, 0] / p[:, 2] / half / 2) * film.width - film.crop_offset_x
    y = (0.5 - camera.principal_point_offset_y) * film.height - p[:, 1] / p[:, 2] / half / 2 * film.width
    limit = 1e5
    x, y = np.clip(x, -limit, limit), np.clip(y - film.crop_offset_y, -limit, limit)
    return [(float(x[0]), float(y[0])), (float(x[1]), float(y[1]))]


def _heat(values: np.ndarray) -> np.ndarray:
    """(H, W) values from 0 to 1 as colours (H, W, 3) uint8."""
    stops = np.linspace(0, 1, len(_HEAT))
    channels = [np.interp(values, stops, _HEAT[:, c]) for c in range(3)]
    return np.stack(channels, axis=-1).astype(np.uint8)


def _caption(text: str, width: int) -> np.ndarray:
    picture = Image.new("RGB", (width, 16), (0, 0, 0))
    ImageDraw.Draw(picture).text((4, 2), text, fill=(230, 230, 230))
    return np.asarray(picture)
