"""The bits of a placement: where a leaf lies in its billboard, how it is turned, and which shape it has.

Four words of 32 bits, from the least significant bit:

    word 0   x 16, y 16                     position in the billboard's box, 0..65535 from side to side
    word 1   z 16, scale 16                 scale: largest * 2^(-n / 4096)
    word 2   a 13, b 13, narrowing 6        narrowing: the width's factor, 2^(-n / 8)
    word 3   c 13, left out 2, mirrored 1, shape 14, two bits 0

a, b, c are the quaternion without its largest part, which is positive and is left out: `left out` says which of
(x, y, z, w) it is. They run from -1/sqrt(2) to 1/sqrt(2), which is 0..8191. No leaf is off by more than 0.02 degrees.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from treebake.model import Doubles, Ints, Words

SHAPES = 1 << 14  # that the bits can tell apart

_POSITION = 65535
_SCALE_STEPS, _SCALE_MOST = 4096, 65535
_NARROW_STEPS, _NARROW_MOST = 8, 63
_PART = 8191


@dataclass(frozen=True, eq=False)
class Placements:
    """N leaves in their billboards.

    positions: (N, 3) float64, 0..1 from side to side of the billboard's box. rotations: (N, 3, 3) float64, takes the
    leaf's frame (right, down, away) into the billboard's. scales: (N,) float64, over the largest leaf's. narrowings:
    (N,) float64, the width's factor. shape: (N,) int32. mirrored: (N,) bool, whether the image is reversed sidewards.
    """

    positions: Doubles
    rotations: Doubles
    scales: Doubles
    narrowings: Doubles
    shape: Ints
    mirrored: NDArray[np.bool_]


def pack(placed: Placements) -> Words:
    """Encode placements: (N, 4) uint32. Values are rounded to the nearest that the bits can hold, or clipped."""
    x, y, z = np.rint(np.clip(placed.positions, 0, 1) * _POSITION).T
    scale = np.clip(np.rint(-_SCALE_STEPS * np.log2(placed.scales)), 0, _SCALE_MOST)
    narrowing = np.clip(np.rint(-_NARROW_STEPS * np.log2(placed.narrowings)), 0, _NARROW_MOST)
    quaternion = Rotation.from_matrix(placed.rotations).as_quat()  # x, y, z, w
    left_out = np.abs(quaternion).argmax(axis=1)
    rows = np.arange(len(quaternion))
    quaternion *= np.where(quaternion[rows, left_out] < 0, -1, 1)[:, None]
    kept = quaternion[rows[:, None], _KEPT[left_out]]
    a, b, c = np.rint(np.clip(kept * np.sqrt(0.5) + 0.5, 0, 1) * _PART).T
    fields = (
        ((x, 0), (y, 16)),
        ((z, 0), (scale, 16)),
        ((a, 0), (b, 13), (narrowing, 26)),
        ((c, 0), (left_out, 13), (placed.mirrored, 15), (placed.shape, 16)),
    )
    words = [sum(np.asarray(value).astype(np.uint32) << np.uint32(shift) for value, shift in word) for word in fields]
    return np.stack(words, axis=1).astype(np.uint32)


def unpack(words: Words) -> Placements:
    """Decode placements (N, 4) uint32."""
    one, two, three, four = words.astype(np.int64).T
    parts = np.stack([three & _PART, three >> 13 & _PART, four & _PART], axis=1)
    kept = (parts / _PART - 0.5) * np.sqrt(2)
    left_out = four >> 13 & 3
    quaternion = np.empty((len(words), 4))
    rows = np.arange(len(words))
    quaternion[rows[:, None], _KEPT[left_out]] = kept
    quaternion[rows, left_out] = np.sqrt(np.maximum(1 - (kept**2).sum(axis=1), 0))
    return Placements(
        positions=np.stack([one & 0xFFFF, one >> 16, two & 0xFFFF], axis=1) / _POSITION,
        rotations=Rotation.from_quat(quaternion).as_matrix(),
        scales=np.exp2(-(two >> 16) / _SCALE_STEPS),
        narrowings=np.exp2(-(three >> 26) / _NARROW_STEPS),
        shape=(four >> 16).astype(np.int32),
        mirrored=(four >> 15 & 1).astype(bool),
    )


_KEPT = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # the parts that stay, by the one left out
