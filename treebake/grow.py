"""Procedural trees for demo, tests and benchmarks: recursive branching after Weber and Penn, vectorised.

[WP95] J. Weber, J. Penn: Creation and Rendering of Realistic Trees, SIGGRAPH 1995. Each generation of stems sprouts
from the one before, as there; a length profile takes the place of their shape ratio, and a pull upwards that of their
curve angles. Their stem splitting is left out: forked crowns come from strong limbs on a short trunk.

A species is data: `data/SPECIES.toml`, which also holds the leaf's little mesh, and the images that it names.
"""

import difflib
from dataclasses import dataclass
from functools import cache

import msgspec
import numpy as np

from treebake.errors import SettingsError
from treebake.geometry import reject
from treebake.images import read_image
from treebake.model import AlphaMode, Doubles, Floats, Ints, Material, Mesh, Texture
from treebake.resources import resource

MAX_LEAVES = 1_000_000

_SPECIES = ("alder", "chestnut", "cork", "horse-chestnut", "maple", "oak", "shrub")
_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Generation:
    """Stems that sprout alike. A pair of values belongs to base and tip and is blended in between."""

    name: str
    count: float  # mean number per parent; of the first generation, number of stems from the ground
    start: float  # where the lowest sits, as a fraction of the parent's length
    length: tuple[float, ...]  # over the parent's, evenly spaced from the lowest to its tip; in metres of the first
    length_spread: float  # standard deviation of the length, as a fraction of it
    angle: tuple[float, float]  # to the parent at its base and tip, degrees
    angle_spread: float  # standard deviation of it and of the divergence, degrees
    divergence: float  # turn about the parent from node to node, degrees
    whorl: int  # stems per node
    rise: tuple[float, float]  # pull upwards at the stem's base and tip; 1 turns a level stem up by some 45 degrees
    wander: float  # random turning, as `rise`
    segments: int  # tube pieces along the stem
    sides: int  # tube faces around it


@dataclass(frozen=True)
class Leaf:
    """One leaf's mesh and how leaves sit on the last generation of stems."""

    count: int  # leaves of the whole tree
    length: float  # the image's height on the tree, metres
    length_spread: float  # standard deviation of the length, as a fraction of it
    start: float  # as of a generation, so are the next four
    angle: tuple[float, float]
    angle_spread: float
    divergence: float
    whorl: int
    droop: float  # pull downwards on the leaf's tip
    face_up: float  # pull of the leaf's face towards the sky
    face_out: float  # and away from the tree's axis
    face_spread: float  # and at random
    vertices: tuple[tuple[float, float, float], ...]  # across, along, out of the image: in image heights, from mid-foot
    triangles: tuple[tuple[int, int, int], ...]
    image: str


@dataclass(frozen=True)
class Species:
    """All that makes a species, read from `data/SPECIES.toml`."""

    radius: float  # of the trunk's foot above its flare, metres
    thinnest: float  # least radius of any stem, metres
    radius_power: float  # a child's radius is its parent's times (its length / parent's length) to this power
    taper: float  # part of the radius that a stem loses along its length
    flare: float  # part that the trunk's foot is wider
    bark: str  # image
    bark_tile: float  # side of a tile of bark, metres
    stems: tuple[Generation, ...]  # trunk first
    leaf: Leaf


@dataclass(frozen=True, eq=False)
class _Stems:
    """One generation, grown: n stems of r rings."""

    points: Doubles  # (n, r, 3)
    headings: Doubles  # (n, r, 3), unit
    sides: Doubles  # (n, r, 3), unit, at right angles to the headings
    radii: Doubles  # (n, r)
    lengths: Doubles  # (n,)


@dataclass(frozen=True, eq=False)
class _Buds:
    """Where b children sprout."""

    parents: Ints  # (b,)
    fractions: Doubles  # (b,), 0 where the lowest may sit, 1 at the parent's tip
    points: Doubles  # (b, 3), on the parent's centre line
    headings: Doubles  # (b, 3), unit, the parent's there
    outward: Doubles  # (b, 3), unit, at right angles to the headings
    radii: Doubles  # (b,), the parent's there


def species() -> tuple[str, ...]:
    """The names of the species that can be grown."""
    return _SPECIES


def grow(species: str, *, seed: int = 0, leaves: int | None = None) -> Mesh:
    """Grow a tree in metres, foot at the origin, with nodes and materials "trunk" and "leaves", "bark" and "leaf".

    leaves: how many, 1 to 1,000,000; the species' own number if None. A tree with more leaves is an older one: every
    generation is as much more numerous, and the height grows with the cube root so that the crown stays as dense.
    The same arguments give the same bytes. O(leaves).

    Raises SettingsError for an unknown species, a number of leaves out of range or a negative seed.
    """
    plan = _plan(species)
    total = plan.leaf.count if leaves is None else leaves
    if not 1 <= total <= MAX_LEAVES:
        raise SettingsError(f"{total} leaves cannot be grown; ask for 1 to {MAX_LEAVES}")
    if seed < 0:
        raise SettingsError(f"seed {seed} is negative; give 0 or more")
    rng = np.random.Generator(np.random.PCG64(seed))
    age = total / plan.leaf.count
    stems = [_trunk(plan, age ** (1 / 3), rng)]
    abundance = age ** (1 / len(plan.stems))  # of each generation after the trunk, leaves included
    for generation in plan.stems[1:]:
        stems.append(_branch(stems[-1], generation, plan, abundance, rng))
    bark, leaf, aspect = _materials(species)
    return _join(_tubes(stems, plan), _foliage(stems[-1], plan.leaf, total, aspect, rng), (bark, leaf))


@cache
def _plan(name: str) -> Species:
    if name not in _SPECIES:
        near = difflib.get_close_matches(name, _SPECIES, 1, cutoff=0)[0]
        raise SettingsError(f"unknown species {name!r}; did you mean {near}? Known are {', '.join(_SPECIES)}")
    return msgspec.toml.decode(resource(f"data/{name}.toml").read_bytes(), type=Species)


@cache
def _materials(name: str) -> tuple[Material, Material, float]:
    """Bark, leaf, and the height over the width of the leaf's image."""
    plan = _plan(name)
    bark, leaf = (Texture(image, read_image(resource(f"data/{image}.png"))) for image in (plan.bark, plan.leaf.image))
    masked = Material("leaf", color_map=leaf, alpha_mode=AlphaMode.MASK, alpha_cutoff=0.5, double_sided=True)
    return Material("bark", color_map=bark), masked, leaf.pixels.shape[0] / leaf.pixels.shape[1]


def _trunk(plan: Species, size: float, rng: np.random.Generator) -> _Stems:
    """The stems from the ground: one, or several that lean apart."""
    trunk = plan.stems[0]
    n = round(trunk.count)
    azimuth = np.deg2rad(trunk.divergence) * np.arange(n) + rng.uniform(0, 2 * np.pi)
    outward = np.stack([np.cos(azimuth), np.zeros(n), np.sin(azimuth)], axis=1)
    lean = np.deg2rad(np.linspace(*trunk.angle, n) + rng.normal(0, trunk.angle_spread, n))
    headings = _turn(np.tile(_UP, (n, 1)), outward, lean)
    lengths = size * trunk.length[0] * _spread(trunk.length_spread, n, rng)
    radii = np.full(n, size * plan.radius)
    stems = _extend(outward * radii[:, None] * (n > 1), headings, lengths, radii, trunk, plan, rng)
    foot = 1 + plan.flare * 100.0 ** (-8 * np.linspace(0, 1, trunk.segments + 1))  # [WP95] 4.4
    return _Stems(stems.points, stems.headings, stems.sides, stems.radii * foot, stems.lengths)


def _branch(
    parents: _Stems, generation: Generation, plan: Species, abundance: float, rng: np.random.Generator
) -> _Stems:
    """The next generation of stems on their parents."""
    total = max(1, round(generation.count * abundance * len(parents.lengths)))
    buds = _sprout(parents, total, generation, rng)
    along = np.linspace(0, 1, len(generation.length))
    parent_length = parents.lengths[buds.parents]
    ratio = np.interp(buds.fractions, along, generation.length) * _spread(generation.length_spread, total, rng)
    radii = parents.radii[buds.parents, 1] * ratio**plan.radius_power
    angles = np.deg2rad(
        np.interp(buds.fractions, (0, 1), generation.angle) + rng.normal(0, generation.angle_spread, total)
    )
    headings = _turn(buds.headings, buds.outward, angles)
    radii = np.minimum(radii, 0.8 * buds.radii)  # [WP95] 4.4: no thicker than what it grows from
    return _extend(buds.points, headings, ratio * parent_length, radii, generation, plan, rng)


def _extend(
    points: Doubles,
    headings: Doubles,
    lengths: Doubles,
    radii: Doubles,
    generation: Generation,
    plan: Species,
    rng: np.random.Generator,
) -> _Stems:
    """Let n stems grow from their points, segment by segment, turning as they go."""
    along = np.linspace(0, 1, generation.segments + 1)
    flat = np.where(np.abs(headings[:, 1:2]) < 0.99, np.cross(_UP, headings), [1.0, 0.0, 0.0])
    side = _unit(reject(flat, headings))
    rings = [(points, headings, side)]
    for rise in np.interp(along[1:], (0, 1), generation.rise):
        turn = rise * _UP + generation.wander * rng.normal(0, 1, headings.shape)
        headings = _unit(headings + turn / generation.segments)
        side = _unit(reject(side, headings))
        points = points + headings * (lengths / generation.segments)[:, None]
        rings.append((points, headings, side))
    tapered = np.maximum(radii[:, None] * (1 - plan.taper * along), plan.thinnest)
    points, headings, side = (np.stack(ring, axis=1) for ring in zip(*rings, strict=True))
    return _Stems(points, headings, side, tapered, lengths)


def _sprout(parents: _Stems, total: int, habit: Generation | Leaf, rng: np.random.Generator) -> _Buds:
    """Spread exactly `total` buds over the parents by their lengths, in whorls that turn from node to node."""
    share = np.cumsum(parents.lengths)
    counts = np.diff(np.rint(share / share[-1] * total).astype(np.int64), prepend=0)
    parent = np.repeat(np.arange(len(counts)), counts)
    rank = np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)
    node, arm = np.divmod(rank, habit.whorl)
    nodes = -(-counts[parent] // habit.whorl)
    # The last node sits at the tip, so that no stem ends bare.
    fractions = (node + 1 - (node + 1 < nodes) * rng.uniform(0, 0.6, total)) / nodes
    azimuth = np.deg2rad(node * habit.divergence + arm * 360 / habit.whorl + rng.normal(0, habit.angle_spread, total))

    rings = parents.points.shape[1]
    place = (habit.start + (1 - habit.start) * fractions) * (rings - 1)
    ring = np.minimum(place.astype(np.int64), rings - 2)
    blend = (place - ring)[:, None]
    low, high = (parent, ring), (parent, ring + 1)
    points, headings, sides = (
        x[low] * (1 - blend) + x[high] * blend for x in (parents.points, parents.headings, parents.sides)
    )
    radii = parents.radii[low] * (1 - blend[:, 0]) + parents.radii[high] * blend[:, 0]
    headings = _unit(headings)
    side = _unit(reject(sides, headings))
    outward = _turn(side, np.cross(headings, side), azimuth)
    return _Buds(parent.astype(np.int32), fractions, points, headings, outward, radii)


def _tubes(stems: list[_Stems], plan: Species) -> tuple[Floats, Floats, Floats, Ints]:
    """Tapered open tubes around the stems: positions, normals, texture coordinates, faces."""
    parts, first = [], 0
    for grown, generation in zip(stems, plan.stems, strict=True):
        rings = grown.radii.shape[1]
        turn = np.linspace(0, 2 * np.pi, generation.sides + 1)[:, None]  # the seam has two vertices, for the texture
        normals = (
            np.cos(turn) * grown.sides[:, :, None] + np.sin(turn) * np.cross(grown.headings, grown.sides)[:, :, None]
        )
        positions = grown.points[:, :, None] + normals * grown.radii[:, :, None, None]
        tiles = np.maximum(1, np.rint(2 * np.pi * grown.radii[:, 0] / plan.bark_tile))
        uvs = np.empty((*positions.shape[:3], 2))
        uvs[..., 0] = tiles[:, None, None] * np.linspace(0, 1, generation.sides + 1)
        uvs[..., 1] = (grown.lengths[:, None] * np.linspace(1, 0, rings) / plan.bark_tile)[:, :, None]
        vertex = first + np.arange(positions[..., 0].size).reshape(positions.shape[:3])
        first += vertex.size
        a, b, c, d = vertex[:, :-1, :-1], vertex[:, :-1, 1:], vertex[:, 1:, 1:], vertex[:, 1:, :-1]
        faces = np.stack([a, b, c, a, c, d], axis=-1)
        parts.append((positions.reshape(-1, 3), normals.reshape(-1, 3), uvs.reshape(-1, 2), faces.reshape(-1, 3)))
    positions, normals, uvs, faces = (np.concatenate(part) for part in zip(*parts, strict=True))
    return positions.astype(np.float32), normals.astype(np.float32), uvs.astype(np.float32), faces.astype(np.int32)


def _foliage(
    twigs: _Stems, leaf: Leaf, total: int, aspect: float, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats, Ints]:
    """Exactly `total` copies of the leaf's mesh, as `_tubes`; each is turned, moved and scaled as a whole."""
    buds = _sprout(twigs, total, leaf, rng)
    angles = np.deg2rad(np.interp(buds.fractions, (0, 1), leaf.angle) + rng.normal(0, leaf.angle_spread, total))
    along = _unit(_turn(buds.headings, buds.outward, angles) - leaf.droop * _UP)
    away = _unit(buds.points * [1.0, 0.0, 1.0] + 1e-9)
    face = leaf.face_up * _UP + leaf.face_out * away + leaf.face_spread * rng.normal(0, 1, along.shape)
    face = _unit(reject(face, along))
    scale = leaf.length * _spread(leaf.length_spread, total, rng)
    frames = np.stack([np.cross(along, face), along, face], axis=1).astype(np.float32)
    feet = (buds.points + buds.outward * buds.radii[:, None]).astype(np.float32)

    shape = np.array(leaf.vertices, np.float32)
    triangles = np.array(leaf.triangles, np.int32)
    positions = (shape @ frames) * scale.astype(np.float32)[:, None, None] + feet[:, None]
    normals = _vertex_normals(shape, triangles) @ frames
    uvs = np.tile(np.stack([0.5 + shape[:, 0] * aspect, 1 - shape[:, 1]], axis=1), (total, 1))
    faces = (triangles + np.arange(total, dtype=np.int32)[:, None, None] * len(shape)).reshape(-1, 3)
    return positions.reshape(-1, 3), normals.reshape(-1, 3), uvs, faces


def _join(
    trunk: tuple[Floats, Floats, Floats, Ints],
    leaves: tuple[Floats, Floats, Floats, Ints],
    materials: tuple[Material, Material],
) -> Mesh:
    positions, normals, uvs = (np.concatenate(pair) for pair in zip(trunk[:3], leaves[:3], strict=True))
    is_leaf = np.repeat(np.array([0, 1], np.int32), [len(trunk[3]), len(leaves[3])])
    return Mesh(
        positions=positions,
        normals=normals,
        uvs=uvs,
        faces=np.concatenate([trunk[3], leaves[3] + np.int32(len(trunk[0]))]),
        face_material=is_leaf,
        face_node=is_leaf,
        materials=materials,
        nodes=("trunk", "leaves"),
    )


def _vertex_normals(positions: Floats, triangles: Ints) -> Floats:
    a, b, c = (positions[corner] for corner in triangles.T)
    normals = np.zeros_like(positions)
    for corner in triangles.T:
        np.add.at(normals, corner, np.cross(b - a, c - a))
    unit: Floats = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit


def _spread(deviation: float, n: int, rng: np.random.Generator) -> Doubles:
    """Random factors about 1, within two standard deviations."""
    return 1 + deviation * np.clip(rng.normal(0, 1, n), -2, 2)


def _turn(start: Doubles, towards: Doubles, angles: Doubles) -> Doubles:
    """Turn unit vectors by (n,) angles in radians towards others at right angles to them."""
    turned: Doubles = start * np.cos(angles)[:, None] + towards * np.sin(angles)[:, None]
    return turned


def _unit(vectors: Doubles) -> Doubles:
    unit: Doubles = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit
