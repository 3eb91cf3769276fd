"""Which faces are trunk and which are foliage, and why."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch

import numpy as np
from numpy.typing import NDArray

from treebake.errors import SettingsError
from treebake.geometry import components, shared_edges, weld
from treebake.images import to_linear
from treebake.model import AlphaMode, Decision, Material, Mesh
from treebake.stages.split.patches import by_first, measure

Mask = NDArray[np.bool_]

# Short words count at the start of a word only: a particle system has no stem, a catalogue is no log.
_FOLIAGE_WORDS = re.compile(
    r"(?i:lea[fv]|foliage|frond|needle|flower|blossom|petal|canopy)|(?i:(?<![a-z])(grass|fern|crown))|Grass|Fern|Crown"
)
_TRUNK_WORDS = re.compile(r"(?i:bark|trunk|branch|twig)|(?i:(?<![a-z])(wood|stem|root|log(?![a-z])))|Wood|Stem|Root")
_DECISIVE = 3.0  # points at which a material goes one way whatever its geometry says
_CUT_AWAY = 0.05  # share of transparent texels from which a texture counts as cut out
_HOLLOW, _ROUND = 0.25, 0.35  # resultant below which, and bend above which, a piece is a tube or body; see Patches

Evidence = tuple[float, str]


@dataclass(frozen=True)
class Names:
    """Names or patterns that the user gives: of foliage materials, of foliage nodes, of trunk materials."""

    foliage_materials: tuple[str, ...]
    foliage_nodes: tuple[str, ...]
    trunk_materials: tuple[str, ...]


def decide(mesh: Mesh, names: Names) -> tuple[Mask, tuple[Decision, ...]]:
    """Tell foliage from trunk: (F,) bool, true for foliage, and one decision for each group of faces.

    What the user names goes first. Of the rest, a lone material is split by its geometry; with several, each goes one
    way by what its name, texture, sidedness and geometry say, and one that stays open is split by its geometry too.

    Raises SettingsError where a name matches nothing.
    """
    foliage, decided = np.zeros((2, mesh.triangles), bool)
    decisions: list[Decision] = []

    def settle(group: str, faces: Mask, is_foliage: bool, reason: str) -> None:
        if faces.any():
            foliage[faces], decided[faces] = is_foliage, True
            decisions.append(Decision(group, "foliage" if is_foliage else "trunk", int(faces.sum()), reason))

    for node in _matching("foliage_nodes", names.foliage_nodes, mesh.nodes):
        settle(f"node {mesh.nodes[node]}", mesh.face_node == node, True, "foliage_nodes names it")
    named = [material.name for material in mesh.materials]
    for key, patterns in (("trunk_materials", names.trunk_materials), ("foliage_materials", names.foliage_materials)):
        for material in _matching(key, patterns, named):
            faces = ~decided & (mesh.face_material == material)
            settle(f"material {named[material]}", faces, key == "foliage_materials", f"{key} names it")

    alone = len(np.unique(mesh.face_material)) == 1
    for row in np.unique(mesh.face_material[~decided]):
        group = f"material {named[row]}"
        faces = ~decided & (mesh.face_material == row)
        evidence = [] if alone else _evidence(mesh, int(row))
        points = sum(point for point, _ in evidence)
        if abs(points) >= _DECISIVE:
            settle(group, faces, points > 0, _words(evidence, points))
            continue
        sheets, share = _sheets(mesh, faces)
        if share > 0.5:
            evidence.append((2.0, f"{share:.0%} of its area is open sheets, as leaves are"))
        else:
            evidence.append((-2.0, f"{1 - share:.0%} of its area is tubes or closed bodies, as branches are"))
        points = sum(point for point, _ in evidence)
        if (alone or abs(points) < _DECISIVE) and 0 < share < 1:
            settle(f"{group}, sheets", faces & sheets, True, "open and flat or gently bent, as leaves are")
            settle(f"{group}, solids", faces & ~sheets, False, "tubes or closed bodies, as branches are")
        else:
            settle(group, faces, points > 0, _words(evidence, points))
    return foliage, tuple(decisions)


def _matching(key: str, patterns: Sequence[str], names: Sequence[str]) -> list[int]:
    """The rows of the names that a pattern matches, whatever the case."""
    found = set()
    for pattern in patterns:
        rows = [row for row, name in enumerate(names) if fnmatch(name.lower(), pattern.lower())]
        if not rows:
            raise SettingsError(f'{key} = "{pattern}" matches nothing in this mesh; it has {", ".join(names)}')
        found.update(rows)
    return sorted(found)


def _evidence(mesh: Mesh, row: int) -> list[Evidence]:
    """What a material looks like beside the others: points for foliage, below zero for trunk, and the reason."""
    material = mesh.materials[row]
    others = [mesh.materials[other] for other in np.unique(mesh.face_material) if other != row]
    nodes = " ".join(mesh.nodes[node] for node in np.unique(mesh.face_node[mesh.face_material == row]))
    image = material.color_map.name if material.color_map else ""
    evidence = []
    for text, what, weight in ((material.name, "its name", 3.0), (image, "its texture", 2.0), (nodes, "its node", 2.0)):
        leafy, woody = _FOLIAGE_WORDS.search(text), _TRUNK_WORDS.search(text)
        if bool(leafy) != bool(woody):
            subject = "leaves" if leafy else "wood"
            evidence.append((weight if leafy else -weight, f"{what} {text} speaks of {subject}"))
            break
    cut_away = _cut_away(material)
    if cut_away > _CUT_AWAY:
        evidence.append((3.0, f"{cut_away:.0%} of its texture is transparent"))
    if material.double_sided and not all(other.double_sided for other in others):
        evidence.append((1.0, "it is double-sided and others are not"))
    red, green, blue = _mean_color(material)
    if green > 1.1 * max(red, blue):
        evidence.append((1.0, "it is green"))
    elif red >= green > blue:
        evidence.append((-1.0, "it is brown"))
    return evidence


def _words(evidence: list[Evidence], points: float) -> str:
    """The reasons for a decision, and those against it."""
    agreeing = [reason for point, reason in evidence if point * points > 0] or ["nothing speaks for foliage"]
    opposing = [reason for point, reason in evidence if point * points < 0]
    return "; though ".join(", ".join(reasons) for reasons in (agreeing, opposing) if reasons)


def _cut_away(material: Material) -> float:
    """The share of a colour map that its material does not draw."""
    if material.color_map is None or material.alpha_mode is AlphaMode.OPAQUE:
        return 0.0
    threshold = 255 * material.alpha_cutoff if material.alpha_mode is AlphaMode.MASK else 128
    return float((material.color_map.pixels[..., 3] < threshold).mean())


def _mean_color(material: Material) -> tuple[float, float, float]:
    """Linear, over the texels that are drawn."""
    mean = np.ones(3)
    if material.color_map is not None:
        pixels = material.color_map.pixels[::4, ::4].reshape(-1, 4)
        drawn = pixels[pixels[:, 3] >= 128] if material.alpha_mode is not AlphaMode.OPAQUE else pixels
        mean = to_linear(drawn[:, :3]).mean(axis=0, dtype=np.float64) if len(drawn) else mean
    red, green, blue = mean * material.base_color[:3]
    return float(red), float(green), float(blue)


def _sheets(mesh: Mesh, faces: Mask) -> tuple[Mask, float]:
    """Which of the faces lie in sheets, not in tubes or closed bodies: (F,) bool, and their share of the area.

    A tube's or body's normals cancel out and spread all round; a leaf's do not, however bent or crossed. Pieces hang
    together by edges, so that a leaf that touches its twig in a vertex is its own.
    """
    corners = mesh.faces[faces]
    welded = weld(mesh.positions)[corners]
    pieces = by_first(components(shared_edges(welded) // 3, len(corners)))
    found = measure(mesh.positions, corners, pieces)
    solid = (found.resultants < _HOLLOW) & (found.bends > _ROUND)
    sheets = np.zeros(len(faces), bool)
    sheets[faces] = ~solid[pieces]
    return sheets, float(found.areas[~solid].sum() / found.areas.sum())
