"""Pictures on crossed cards with standard materials: what any glTF viewer shows of slicings and views."""

from collections.abc import Sequence

import numpy as np

from treebake.coverage import preserve_coverage
from treebake.errors import BudgetError
from treebake.gl.photo import Photo, Shot
from treebake.images import color_texels, normal_texels, occlusion_map
from treebake.model import AlphaMode, Doubles, Floats, Ints, Material, Mesh, Texture, Transmission
from treebake.pictures import MOST_ATLAS, STEEPEST, covered, pack_pictures, trimmed

_CUTOFF = 0.5
_GUTTER = 2


def crossed_cards(
    shots: Sequence[Shot],
    photos: Sequence[Photo],
    depths: Doubles,
    name: str,
    transmission: Transmission | None = None,
) -> Mesh:
    """A card per photo that shows anything, in one alpha-masked material with colour, normals and occlusion. O(texels).

    depths: (S,) float64, where each card lies along its shot's way to the viewer. The atlas's alpha is shaped, so that
    a viewer's own mipmaps keep the coverage. Cards have two sides, and light goes through all of them alike.
    """
    crops = np.array([trimmed(covered(photo)) for photo in photos], np.int32).reshape(-1, 4)
    shown = np.flatnonzero(crops[:, 2] > crops[:, 0]).tolist()
    crops, turns = crops[shown], np.array([shots[i].turn for i in shown]).reshape(-1, 3, 3)
    packed = pack_pictures(crops[:, 2:] - crops[:, :2], _GUTTER, MOST_ATLAS)
    if packed is None:
        raise BudgetError(
            f"the standard cards of the {name} need more than {MOST_ATLAS} texels a side; "
            "lower the texels of the pictures"
        )
    origins, used = packed
    width, height = (1 << max(side - 1, 1).bit_length() for side in used)  # what shaping asks for
    albedo, normal = np.zeros((height, width, 4), np.float32), np.zeros((height, width, 3), np.float32)
    sky = np.zeros((height, width), np.float32)
    for index, (left, top, right, bottom), (x, y) in zip(shown, crops, origins, strict=True):
        photo, here = photos[index], np.s_[top:bottom, left:right]
        there = np.s_[y : y + bottom - top, x : x + right - left]
        albedo[there] = photo.albedo[here]
        normal[there] = _normals(photo.relief[here], photo.albedo[here][..., 3])
        sky[there] = photo.relief[here][..., 3]
    alpha = preserve_coverage(albedo[..., 3], _CUTOFF)
    texels = np.dstack([color_texels(albedo), np.rint(alpha * 255).astype(np.uint8)])
    material = Material(
        name=name,
        color_map=Texture(f"{name}_color", texels),
        normal_map=Texture(f"{name}_normal", normal_texels(normal, albedo[..., 3])),
        occlusion_map=occlusion_map(f"{name}_occlusion", sky, albedo[..., 3]),
        alpha_mode=AlphaMode.MASK,
        alpha_cutoff=_CUTOFF,
        double_sided=True,
        transmission=transmission,
    )
    texel = np.array([(shots[i].high - shots[i].low)[0] / shots[i].size[0] for i in shown]).reshape(-1, 1)
    corner = np.array([[shots[i].low[0], shots[i].high[1]] for i in shown]).reshape(-1, 2)
    return _cards(turns, corner, texel, depths[shown], crops, origins, (width, height), material)


def _normals(relief: Floats, alpha: Floats) -> Floats:
    """Unit normals, premultiplied, of premultiplied slopes."""
    slopes = (relief[..., :2] / np.maximum(alpha, 1e-6)[..., None] * 2 - 1) * STEEPEST
    normals = np.dstack([slopes, np.ones_like(alpha)])
    return np.asarray(normals / np.linalg.norm(normals, axis=2, keepdims=True) * alpha[..., None], np.float32)


def _cards(
    turns: Doubles,
    corner: Doubles,
    texel: Doubles,
    depths: Doubles,
    crops: Ints,
    origins: Ints,
    size: tuple[int, int],
    material: Material,
) -> Mesh:
    """Two triangles per picture; a card reaches a gutter past it, where mips spread it."""
    count = len(turns)
    steps = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])  # left bottom, right bottom, right top, left top
    within = steps * (crops[:, None, 2:] - crops[:, None, :2] + 2 * _GUTTER) - _GUTTER
    place = corner[:, None] + (crops[:, None, :2] + within) * [1, -1] * texel[:, None]
    along = np.concatenate([place, np.broadcast_to(depths[:, None, None], (count, 4, 1))], axis=2)
    quads = np.arange(count, dtype=np.int32)[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Mesh(
        positions=np.einsum("cki,cij->ckj", along, turns).reshape(-1, 3).astype(np.float32),
        normals=turns[:, 2].repeat(4, axis=0).astype(np.float32),
        uvs=((origins[:, None] + within) / np.array(size)).reshape(-1, 2).astype(np.float32),
        faces=quads.reshape(-1, 3),
        face_material=np.zeros(2 * count, np.int32),
        face_node=np.zeros(2 * count, np.int32),
        materials=(material,),
        nodes=(material.name,),
    )
