"""What the commands report: plain numbers and texts by name, ready for the terminal or for JSON."""

from pathlib import Path
from typing import Any

import numpy as np

from treebake.asset import read_asset
from treebake.meshes import read_mesh
from treebake.model import Mesh, Tree
from treebake.pipeline import Clustered
from treebake.settings import Settings
from treebake.stages.cluster import cluster_statistics
from treebake.stages.split import split

Facts = dict[str, Any]


def of_mesh(mesh: Mesh) -> Facts:
    """What a mesh is made of."""
    low, high = mesh.bounds
    faces = np.bincount(mesh.face_material, minlength=len(mesh.materials))
    return {
        "triangles": mesh.triangles,
        "vertices": len(mesh.positions),
        "size": [round(float(extent), 4) for extent in high - low],
        "nodes": list(mesh.nodes),
        "materials": [
            {
                "name": material.name,
                "triangles": int(count),
                "alpha": str(material.alpha_mode),
                "double_sided": material.double_sided,
                "colour map": "x".join(map(str, material.color_map.pixels.shape[1::-1])) if material.color_map else "",
            }
            for material, count in zip(mesh.materials, faces, strict=True)
        ],
    }


def of_tree(tree: Tree) -> Facts:
    """Where the split put what, and why."""
    return {
        "leaves": int(np.count_nonzero(~tree.leaves.is_twig)),
        "leaf shapes": len(tree.leaves.exemplars),
        "split": [
            {"role": d.role, "triangles": d.triangles, "group": d.group, "why": d.reason} for d in tree.decisions
        ],
    }


def of_clustered(done: Clustered) -> Facts:
    """What `treebake cluster` prints."""
    tree = done.tree.value
    facts = of_tree(done.split.value)
    facts["twig triangles moved to the foliage"] = tree.foliage.triangles - done.split.value.foliage.triangles
    if done.clusters:
        facts["billboards"] = done.clusters.value.count
        facts["fit"] = cluster_statistics(tree.leaves, done.clusters.value)
    return facts
