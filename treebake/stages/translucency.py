"""What leaves let through, where their source does not say.

Hemispherical reflectance and transmittance at red, green and blue, rounded; the broad leaf's are typical of measured
spectra ([HJA95]: LOPEX93), the needle's are assumed:

    broad leaf   0.05 0.10 0.04   0.04  0.10 0.02
    needle       0.04 0.09 0.03   0.006 0.02 0.003

A base colour is painted to be seen from the lit side, so it stands for reflectance. Of what is not absorbed `factor`
goes through and the rest comes back: at green, which is nearly all that the eye sees of a leaf, transmittance over
reflectance is factor / (1 - factor), so it is 0.5 and 0.18. The tint, a factor on the base colour, is that ratio at
each colour over the one at green: (0.8, 1, 0.5) and (0.7, 1, 0.45).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from treebake.checks import check
from treebake.images import mean_texel
from treebake.model import Floats, Material, Translucency, Transmission, Tree

_DEFAULTS = {
    "broad leaf": Transmission(0.5, (0.8, 1.0, 0.5)),
    "needle": Transmission(0.18, (0.7, 1.0, 0.45)),
}
_SLENDER = 0.1  # area over squared length of a needle, at most: of an ellipse, eight times as long as wide
_SHORT = 0.03  # length of a needle over the crown's, at most; the leaflets of a palm are as slender, and longer
_DARKEST = 1e-4  # of a mean colour on which another is a factor


@dataclass(frozen=True)
class TranslucencySettings:
    """What light goes through leaves; what the source says wins."""

    enabled: bool = True  # whether light goes through leaves; false: none does, not even where the source says so
    leaf_type: str = "auto"  # of materials that do not say: "broad", "needle", or "auto", by the shape of their leaves


def translucency(tree: Tree, settings: TranslucencySettings) -> Tree:
    """Give every material of leaves a transmission, and the tree the mean of them. O(faces + texels).

    Needles are the leaves of a material that have, together, less area than 0.1 times their squared lengths, and in the
    mean a length below 0.03 of the crown's greatest extent; a leaf on a card is as broad as the card. Materials of twig
    pieces alone, or of the trunk, get none.
    Raises SettingsError where a setting is out of range.
    """
    known = settings.leaf_type in ("auto", "broad", "needle")
    check("translucency", settings, [("leaf_type", known, '"auto", "broad" or "needle"')])
    if not settings.enabled:
        return _opaque(tree)
    of_leaf = ~tree.leaves.is_twig[tree.leaves.face_leaf]
    used, face_used = np.unique(tree.foliage.face_material[of_leaf], return_inverse=True)
    if not len(used):
        return tree
    materials, through, origins = list(tree.foliage.materials), [], set()
    for index in used.tolist():
        own, origin = materials[index].transmission, "source"
        if own is None:
            origin = "needle" if _is_needle(tree, index, settings.leaf_type) else "broad leaf"
            own = _tinted(_DEFAULTS[origin], materials[index])
            materials[index] = replace(materials[index], transmission=own)
        through.append(own)
        origins.add(origin)
    areas = np.bincount(face_used, tree.foliage.face_areas[of_leaf])
    mean = _mean([materials[index] for index in used.tolist()], through, (areas / areas.sum()).astype(np.float32))
    lit = Translucency(mean, ", ".join(sorted(origins))) if mean.factor else None
    return replace(tree, foliage=replace(tree.foliage, materials=tuple(materials)), translucency=lit)


def _opaque(tree: Tree) -> Tree:
    shared = (*tree.trunk.materials, *tree.foliage.materials)
    opaque = {id(material): replace(material, transmission=None) for material in shared}
    trunk, foliage = (
        replace(mesh, materials=tuple(opaque[id(material)] for material in mesh.materials))
        for mesh in (tree.trunk, tree.foliage)
    )
    return replace(tree, trunk=trunk, foliage=foliage, translucency=None)


def _is_needle(tree: Tree, material: int, leaf_type: str) -> bool:
    if leaf_type != "auto":
        return leaf_type == "needle"
    leaves = np.unique(tree.leaves.face_leaf[tree.foliage.face_material == material])
    leaves = leaves[~tree.leaves.is_twig[leaves]]
    lengths, crown = 2 * tree.leaves.radii[leaves], float(np.ptp(tree.foliage.bounds, axis=0).max())
    return bool(tree.leaves.areas[leaves].sum() < _SLENDER * (lengths**2).sum() and lengths.mean() < _SHORT * crown)


def _tinted(default: Transmission, material: Material) -> Transmission:
    red, green, blue = (tint * base for tint, base in zip(default.color, material.base_color, strict=False))
    return Transmission(default.factor, (red, green, blue))


def _mean(materials: Sequence[Material], through: Sequence[Transmission], shares: Floats) -> Transmission:
    """The mean factor, and the colour with which as much of the mean leaf's light goes through as of all of them."""
    maps = np.array([mean_texel(each.color_map, each)[:3] if each.color_map else np.ones(3) for each in materials])
    base = shares @ (maps * [each.base_color[:3] for each in materials])
    factors = np.array([each.factor for each in through])
    factor = float(shares @ factors)
    passed = shares @ (factors[:, None] * maps * [each.color for each in through])
    red, green, blue = (passed / np.maximum(factor * base, _DARKEST)).round(6).tolist()
    return Transmission(round(factor, 6), (red, green, blue))
