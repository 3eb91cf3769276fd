"""What the commands report: plain numbers and texts by name, ready for the terminal or for JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from treebake.asset import Asset, LeftOut, Rung, read_asset
from treebake.model import Forest, Mesh, Tree, TrunkMaps
from treebake.stages.cluster import cluster_statistics

if TYPE_CHECKING:
    from treebake.pipeline import Baked, Clustered

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
                "color_map": "x".join(map(str, material.color_map.pixels.shape[1::-1])) if material.color_map else "",
            }
            for material, count in zip(mesh.materials, faces, strict=True)
        ],
    }


def of_tree(tree: Tree) -> Facts:
    """Where the split put what, and why."""
    return {
        "leaves": int(np.count_nonzero(~tree.leaves.is_twig)),
        "leaf_shapes": len(tree.leaves.exemplars),
        "split": [
            {"role": d.role, "triangles": d.triangles, "group": d.group, "why": d.reason} for d in tree.decisions
        ],
    }


def of_clustered(done: "Clustered") -> Facts:
    """What `treebake cluster` prints."""
    tree = done.tree.value
    facts = of_tree(done.split.value)
    facts["twig_triangles_moved_to_foliage"] = tree.foliage.triangles - done.split.value.foliage.triangles
    through = done.split.value.translucency
    facts["translucency"] = f"{through.transmission.factor:.2f}, {through.origin}" if through else "none"
    if done.clusters:
        fit = cluster_statistics(tree.leaves, done.clusters.value)
        facts["billboards"] = fit.billboards
        facts["fit"] = {  # a source unit is a metre, by glTF's rule
            "distance_mean_cm": 100 * fit.distance_mean,
            "distance_worst_cm": 100 * fit.distance_worst,
            "distance_mean_percent_of_leaf_size": fit.distance_percent,
            "angle_mean_degrees": fit.angle_mean,
            "angle_worst_degrees": fit.angle_worst,
        }
    if done.indirect_clusters:
        facts["indirect_billboards"] = done.indirect_clusters.value.count
    return facts


def of_baked(baked: "Baked") -> Facts:
    """What `treebake textures` prints: the manifest, and how much of the trunk is left."""
    trunk = {
        **asdict(baked.trunk),
        "silhouette_kept_by_levels": [round(kept, 4) for kept in baked.silhouettes_kept],
        "maps": _phrase(baked.trunk_maps),
    }
    return {**of_asset(baked.folder), "trunk": trunk}


def _phrase(maps: TrunkMaps) -> str:
    if maps.kind == "none":
        return maps.kind
    if maps.kind == "tiled" and maps.source_density <= maps.density:
        return "tiled: the source's own, because the trunk was not simplified or is not opaque"
    source = f"{maps.source_density:.3g} repeating" if maps.source_density else "no repeating"
    return f"{maps.kind}: the source has {source} texels per unit, a map of its own {maps.density:.3g}"


def of_asset(folder: Path) -> Facts:
    """What the manifest of a published asset says. Raises AssetError."""
    manifest = read_asset(folder).manifest
    return {
        "name": manifest.name,
        "made_by": manifest.generator,
        "source_triangles": manifest.source.triangles,
        "levels": [{**asdict(level), "representations": "+".join(level.representations)} for level in manifest.levels],
        **({"ladder": [_rung(rung) for rung in manifest.ladder]} if manifest.ladder else {}),
        **({"left_out": [_rung(each) for each in manifest.left_out]} if manifest.left_out else {}),
        **({"indirect": asdict(manifest.indirect)} if manifest.indirect else {}),
        **({"slicings": asdict(manifest.slicings)} if manifest.slicings else {}),
        **({"views": {**asdict(manifest.views), "pictures": len(manifest.views.pictures)}} if manifest.views else {}),
        "textures": [{**asdict(image), "size": "x".join(map(str, image.size))} for image in manifest.textures],
    }


def _rung(rung: Rung | LeftOut) -> Facts:
    return {**asdict(rung), "level": "" if rung.level is None else rung.level}


def of_forest(path: Path, forest: Forest, assets: Sequence[Asset]) -> Facts:
    """What a forest file holds. triangles: of all instances at their nearest level."""
    counts = np.bincount(forest.species, minlength=len(assets)).tolist()
    nearest = [asset.manifest.levels[0] for asset in assets]
    return {
        "file": str(path),
        "instances": len(forest.places),
        "species": [
            {"name": name, "trees": trees, "levels": len(asset.manifest.levels)}
            for name, trees, asset in zip(forest.names, counts, assets, strict=True)
        ],
        "cells": len(forest.cells.first),
        "triangles": sum(
            trees * (level.foliage_triangles + level.trunk_triangles)
            for trees, level in zip(counts, nearest, strict=True)
        ),
        "bytes": path.stat().st_size,
    }
