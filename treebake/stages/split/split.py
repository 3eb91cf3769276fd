"""The stage: settings in, tree out."""

import logging
from dataclasses import dataclass

import numpy as np

from treebake.errors import SettingsError
from treebake.model import Leaves, Mesh, Tree
from treebake.stages.split.congruence import find_shapes
from treebake.stages.split.patches import cut_into_leaves, measure
from treebake.stages.split.roles import Names, decide

LOG = logging.getLogger("treebake")


@dataclass(frozen=True)
class SplitSettings:
    """How a tree is split; names are those of the mesh, * and ? stand for any text, case is ignored."""

    foliage_materials: tuple[str, ...] = ()  # materials that are foliage whatever they look like
    foliage_nodes: tuple[str, ...] = ()  # nodes that are foliage whatever their material
    trunk_materials: tuple[str, ...] = ()  # materials that are trunk whatever they look like
    bend: float = 0.3  # 0..1, how far a leaf may depart from a plane before it is cut: 0 flat, 0.5 a half-turn
    large_leaf: float = 0.2  # of the tree's radius, > 0; a leaf larger than this may bend less, in proportion
    copy_tolerance: float = 0.02  # of a leaf's radius, >= 0; greatest distance between the vertices of two copies


def split(mesh: Mesh, settings: SplitSettings = SplitSettings()) -> Tree:
    """Split a mesh into trunk and foliage, the foliage into leaves, and find the leaves that are copies.

    A leaf is the smallest near-planar patch: a welded component, or a part of one that bends too much. Decisions say
    which faces went where and why; an all-trunk result is logged as a warning. O(F log F).

    Raises SettingsError for a name that matches nothing, or a value out of range.
    """
    if not (0 <= settings.bend <= 1 and settings.large_leaf > 0 and settings.copy_tolerance >= 0):
        raise SettingsError("split needs bend in 0..1, large_leaf > 0 and copy_tolerance >= 0; correct these settings")
    names = Names(settings.foliage_materials, settings.foliage_nodes, settings.trunk_materials)
    is_foliage, decisions = decide(mesh, names)
    if not is_foliage.any():
        LOG.warning(
            "split: no foliage can be told apart in this mesh, so all %d triangles are trunk; if that is wrong, "
            "name the leaves in foliage_materials or foliage_nodes",
            mesh.triangles,
        )
    foliage = mesh.select(is_foliage)
    radius = float(np.linalg.norm(np.ptp(mesh.bounds, axis=0))) / 2
    face_leaf = cut_into_leaves(foliage, settings.bend, settings.large_leaf * radius)
    found = measure(foliage.positions, foliage.faces, face_leaf)
    shape, exemplars, transforms = find_shapes(foliage, face_leaf, settings.copy_tolerance)
    leaves = Leaves(
        face_leaf=face_leaf,
        centers=found.centers,
        normals=found.normals,
        areas=found.areas,
        radii=found.radii,
        axes=np.zeros_like(found.centers),
        shape=shape,
        exemplars=exemplars,
        transforms=transforms,
    )
    return Tree(mesh.select(~is_foliage), foliage, leaves, decisions)
