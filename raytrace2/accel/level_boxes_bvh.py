"""The boxes of hierarchies and of flat lists of volumes, as the words on the device hold them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..surfaces.levels import Level, root_level
from .bounding_volumes_traversal import DeviceVolumes
from .bvh_traversal import Nodes
from .level_boxes_volumes import volume_boxes
from .topology import Topology
from .volume_nodes import VolumeNodes
from .wide_boxes import QuantisedNodes
from .wide_node import CORNER, EXPONENTS, NEXT, NodeFormat, NodeLayout

Boxes = tuple[np.ndarray, np.ndarray]


def bvh_levels(bounds: Boxes, nodes: Nodes, topology: Topology, volume: str) -> Iterator[Level]:
    """The root's ``bounds`` and then, level by level, what of the children's volumes lies within their parents'.

    That is what rays get to: the planes of a child that is rounded outwards may lie beyond those of its parent.
    """
    level = root_level(bounds, leaf=len(topology.references) == 0)
    yield level
    words = _rows(nodes)
    width = topology.width
    node = np.flatnonzero(~level.leaf)
    while len(node):
        references = topology.references[node]
        owner, slot = np.nonzero(references != NEXT)
        if isinstance(nodes, QuantisedNodes):
            lo, hi = quantised_boxes(words[node[owner]], slot, nodes.layout, NodeFormat.of(nodes.types))
        else:
            lo, hi = volume_boxes(words[node[owner] * width + slot], volume)
        parent = np.flatnonzero(~level.leaf)[owner]
        inside = np.maximum(lo, level.lo[parent]), np.minimum(hi, level.hi[parent])
        reference = references[owner, slot]
        level = Level(*inside, parent, reference > NEXT)
        yield level
        node = reference[reference < NEXT].astype(np.int64)


def volume_levels(bounds: Boxes, device: DeviceVolumes, volume: str) -> Iterator[Level]:
    """The ``bounds`` of everything and, in one level, what of the volumes lies within them."""
    yield (root := root_level(bounds, leaf=False))
    count = int(device.count.numpy()[0])
    lo, hi = volume_boxes(device.words.numpy().reshape(-1, device.volume.width)[:count], volume)
    inside = np.maximum(lo, root.lo), np.minimum(hi, root.hi)
    yield Level(*inside, np.zeros(count, np.int64), np.ones(count, bool))


def quantised_boxes(words: np.ndarray, slot: np.ndarray, layout: NodeLayout, form: NodeFormat) -> Boxes:
    """The boxes (n, 3), (n, 3) of the children ``slot`` (n,) of nodes of ``words`` (n, layout.words): a corner and
    whole numbers of steps from it, rounded outwards where float64 cannot hold them."""
    corner = np.ascontiguousarray(words[:, CORNER : CORNER + 3])
    corner = corner.view(np.float32 if form.word == np.uint32 else np.float64).astype(np.float64)
    bounds = np.empty((2, len(words), 3))
    rows = np.arange(len(words))
    shift = (8 * (slot % 4)).astype(form.word)
    for axis in range(3):
        exponent = words[:, EXPONENTS] >> form.word.type(axis * form.exponent_bits)
        exponent = (exponent & form.word.type((1 << form.exponent_bits) - 1)).astype(np.int64)
        step = np.ldexp(1.0, exponent - form.bias - 8)
        for side, first in enumerate((layout.lower, layout.upper)):
            byte = words[rows, first + axis * layout.per_axis + slot // 4] >> shift & form.word.type(255)
            bounds[side, :, axis] = _sum(corner[:, axis], byte * step, (-np.inf, np.inf)[side])
    return bounds[0], bounds[1]


def _sum(a: np.ndarray, b: np.ndarray, towards: float) -> np.ndarray:
    """a + b, rounded ``towards`` an infinity."""
    total = a + b
    back = total - a
    rest = (a - (total - back)) + (b - back)
    return np.where(rest * np.sign(towards) > 0, np.nextafter(total, towards), total)


def _rows(nodes: Nodes) -> np.ndarray:
    """The words of nodes, or of their children's volumes, a row each."""
    assert isinstance(nodes, QuantisedNodes | VolumeNodes)
    row = nodes.layout.words if isinstance(nodes, QuantisedNodes) else nodes.volume.width
    words = nodes.words.numpy()
    return np.asarray(words[: len(words) // row * row]).reshape(-1, row)
