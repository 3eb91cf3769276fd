"""Builds planned tubes as a mesh."""

import numpy as np

from treebake.model import Doubles, Longs, Mesh
from treebake.tubes.find import Rings, Tubes
from treebake.tubes.ladder import Mask
from treebake.tubes.plan import Plan


def loft(mesh: Mesh, tubes: Tubes, chosen: Plan) -> tuple[Mesh, Longs]:
    """Build the planned rings and join each strand's: the mesh, and the strand of each of its faces: (F,).

    Texture coordinates, normals and occlusion are the source's, blended linearly between its vertices; the first vertex
    of a ring comes twice, with the texture coordinates of either side of the seam. Each ring grows about its centre
    until its perimeter is the source's times the plan's width. Caps come back as fans with vertices of their own.
    """
    rings, count = tubes.rings, len(chosen.ring)
    follows = np.append(False, np.diff(chosen.strand) == 0)[:count]
    point = (rings.sides[chosen.ring] == 1) & (chosen.blend == 0)
    beside = np.clip(np.where(follows, np.arange(count) - 1, np.arange(count) + 1), 0, count - 1)
    columns = np.where(point, chosen.sides[beside], chosen.sides)
    offset = np.append(0, np.cumsum(columns + 1))
    row = np.repeat(np.arange(count), columns + 1)
    column = np.arange(len(row)) - offset[row]

    fraction = np.minimum((column + 0.5 * point[row]) / columns[row], 1)
    own = (chosen.sides == rings.sides[chosen.ring])[row] & ~point[row]
    fraction[own] = rings.fractions[(rings.first[chosen.ring][row] + column)[own]]
    after = np.minimum(chosen.ring + 1, len(rings.sides) - 1)
    low = _sample(rings, chosen.ring[row], fraction)
    tip = point[row]  # where the source's normals may cancel out: as on the ring beside
    low[1][tip] = _sample(rings, chosen.ring[beside[row[tip]]], fraction[tip])[1]
    high = _sample(rings, after[row], fraction)
    position, normal, uv, sky = (a + chosen.blend[row, None] * (b - a) for a, b in zip(low, high, strict=True))
    center = rings.centers[chosen.ring] + chosen.blend[:, None] * (rings.centers[after] - rings.centers[chosen.ring])
    perimeter = rings.perimeters[chosen.ring] * (1 - chosen.blend) + rings.perimeters[after] * chosen.blend
    side = np.linalg.norm(np.diff(position, axis=0), axis=1) * (np.diff(row) == 0)
    polygon = np.bincount(row[1:], weights=side, minlength=count)
    # A ring that is not convex has a longer perimeter than its width calls for; no polygon needs to grow more than one
    # in a circle.
    angle = np.pi / np.maximum(chosen.sides, 2)
    growth = np.minimum(perimeter / np.where(polygon > 0, polygon, 1), angle / np.sin(angle)) * chosen.width
    position = center[row] + (position - center[row]) * growth[row, None]

    faces, strand = _zip(columns, point, offset, np.flatnonzero(follows) - 1, chosen.strand)
    cap, cap_row, cap_faces = _caps(tubes, chosen, len(position))
    cap_fraction = fraction[offset[cap_row] + cap[1]]
    _, cap_normal, cap_uv, cap_sky = _sample(tubes.caps, cap[0], cap_fraction)
    position = np.concatenate([position, position[offset[cap_row] + cap[1]]])
    normal = np.concatenate([normal, cap_normal])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    strand = np.concatenate([strand, chosen.strand[cap_row[cap_faces[:, 0] - len(row)]]])
    tube = np.zeros(int(chosen.strand.max(initial=-1)) + 1, np.int64)
    tube[chosen.strand] = tubes.tube[chosen.ring]
    built = Mesh(
        positions=position.astype(np.float32),
        normals=(normal / np.where(length > 0, length, 1)).astype(np.float32),
        uvs=np.concatenate([uv, cap_uv]).astype(np.float32),
        faces=np.concatenate([faces, cap_faces]).astype(np.int32),
        face_material=tubes.material[tube[strand]],
        face_node=tubes.node[tube[strand]],
        materials=mesh.materials,
        nodes=mesh.nodes,
        occlusion=None if mesh.occlusion is None else np.concatenate([sky, cap_sky])[:, 0].astype(np.float32),
    )
    return built, strand


def _sample(rings: Rings, ring: Longs, fraction: Doubles) -> tuple[Doubles, Doubles, Doubles, Doubles]:
    """Position, normal, texture coordinates and occlusion (N, 1) at a fraction of a perimeter, between its samples.

    So is the distance from the centre: the source's polygon stands for a round branch, and points on its sides would
    make a new one that is lopsided.
    """
    owner = np.repeat(np.arange(len(rings.sides)), np.diff(rings.first))
    index = np.searchsorted(2 * owner + rings.fractions, 2 * ring + fraction, side="right") - 1
    index = np.clip(index, rings.first[ring], rings.first[ring + 1] - 2)
    start, stop = rings.fractions[index], rings.fractions[index + 1]
    t = ((fraction - start) / np.where(stop > start, stop - start, 1))[:, None]
    position, normal, uv, sky = (
        values[index] + t * (values[index + 1] - values[index])
        for values in (rings.positions, rings.normals, rings.uvs, rings.occlusion[:, None])
    )
    center = rings.centers[ring]
    near, far = (np.linalg.norm(rings.positions[index + end] - center, axis=1) for end in (0, 1))
    cut = np.linalg.norm(position - center, axis=1)
    bulge = np.where(cut > 0, (near + t[:, 0] * (far - near)) / np.where(cut > 0, cut, 1), 1)
    return center + bulge[:, None] * (position - center), normal, uv, sky


def _zip(columns: Longs, point: Mask, offset: Longs, lower: Longs, strand: Longs) -> tuple[Longs, Longs]:
    """Triangles between each ring of `lower` (P,) and the next: (F, 3), and their strand: (F,).

    Each ring steps from column to column; the steps of both rings are merged by the fraction of their middle, and each
    makes a triangle with the column that the other ring has reached.
    """
    pair, upper, step, middle = [], [], [], []
    for side in (0, 1):
        sides = np.where(point[lower + side], 0, columns[lower + side])
        owner = np.repeat(np.arange(len(lower)), sides)
        index = np.arange(len(owner)) - np.repeat(np.cumsum(sides) - sides, sides)
        pair.append(owner)
        upper.append(np.full(len(owner), side))
        step.append(index)
        middle.append((index + 0.5) / np.maximum(sides, 1)[owner])
    pairs, uppers, steps = (np.concatenate(parts) for parts in (pair, upper, step))
    order = np.lexsort([uppers, np.concatenate(middle), pairs])
    pairs, uppers, steps = pairs[order], uppers[order], steps[order]
    first = np.searchsorted(pairs, np.arange(len(lower)))[pairs]
    passed = np.cumsum(uppers)
    ups = passed - uppers - (passed - uppers)[first]  # steps of the upper ring so far in the pair
    reached = np.where(uppers == 1, np.arange(len(pairs)) - first - ups, ups)
    ring = lower[pairs]
    other = np.where(uppers == 1, ring, ring + 1)
    reached = np.where(point[other], steps, reached)
    here = offset[np.where(uppers == 1, ring + 1, ring)] + steps
    faces = np.stack(
        [np.where(uppers == 1, here + 1, here), np.where(uppers == 1, here, here + 1), offset[other] + reached], axis=1
    )
    return faces, strand[ring]


def _caps(tubes: Tubes, chosen: Plan, base: int) -> tuple[Longs, Longs, Longs]:
    """Fans over the planned rings that a cap closes.

    Gives (2, N) cap and column of each new vertex, (N,) its planned ring, and (F, 3) faces; vertices count from `base`.
    """
    closing = np.isin(chosen.ring, tubes.cap_ring) & (chosen.blend == 0) & (chosen.sides > 2)
    rows = np.flatnonzero(closing)
    sides = chosen.sides[rows]
    offset = np.cumsum(sides) - sides
    owner = np.repeat(np.arange(len(rows)), sides)
    column = np.arange(len(owner)) - offset[owner]
    cap = np.searchsorted(tubes.cap_ring, chosen.ring[rows])
    middle = np.flatnonzero((column > 0) & (column < sides[owner] - 1))
    fan = np.stack([offset[owner[middle]], middle, middle + 1], axis=1)
    is_base = np.isin(chosen.ring[rows], tubes.first[:-1])[owner[middle]]
    fan[is_base] = fan[is_base, ::-1]
    return np.stack([cap[owner], column]), rows[owner], fan + base
