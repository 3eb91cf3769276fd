"""The bits of a placement: where a leaf lies in its billboard, how it is turned, and which shape it has.

Four words of 32 bits, from the least significant bit:

    word 0   x 16, y 16                     position in the billboard's box, 0..65535 from side to side
    word 1   z 16, scale 12 + 4             scale: largest * (1 + m / 4096) * 2^-e
    word 2   a 13, b 13, narrowing 3 + 3    narrowing: the width's factor, (1 + m / 8) * 2^-e
    word 3   c 13, left out 2, mirrored 1, shape 14, two bits 0

a, b, c are the quaternion without its largest part, which is positive and is left out: `left out` says which of
(x, y, z, w) it is. They run from -1/sqrt(2) to 1/sqrt(2), which is 0..8190, so that 0 is one of the values. No leaf is
off by more than 0.04 degrees.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from treebake.model import Doubles, Ints, Words

SHAPES = 1 << 14  # that the bits can tell apart

_POSITION = 65535
_SCALE_BITS, _NARROW_BITS = (12, 4), (3, 3)  # mantissa, exponent
_PART, _PART_BITS = 8190, (1 << 13) - 1


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
    scale, narrowing = _small_float(placed.scales, *_SCALE_BITS), _small_float(placed.narrowings, *_NARROW_BITS)
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
    parts = np.stack([three & _PART_BITS, three >> 13 & _PART_BITS, four & _PART_BITS], axis=1)
    kept = (parts / _PART - 0.5) * np.sqrt(2)
    left_out = four >> 13 & 3
    quaternion = np.empty((len(words), 4))
    rows = np.arange(len(words))
    quaternion[rows[:, None], _KEPT[left_out]] = kept
    quaternion[rows, left_out] = np.sqrt(np.maximum(1 - (kept**2).sum(axis=1), 0))
    return Placements(
        positions=np.stack([one & 0xFFFF, one >> 16, two & 0xFFFF], axis=1) / _POSITION,
        rotations=Rotation.from_quat(quaternion).as_matrix(),
        scales=_float(two >> 16, *_SCALE_BITS),
        narrowings=_float(three >> 26, *_NARROW_BITS),
        shape=(four >> 16).astype(np.int32),
        mirrored=(four >> 15 & 1).astype(bool),
    )


def _small_float(values: Doubles, mantissa: int, exponent: int) -> NDArray[np.int64]:
    """Values in (0, 1] as a few bits of mantissa below a few of exponent, nearest first; too small ones are raised."""
    fraction, power = np.frexp(np.clip(values, 2.0 ** (1 - (1 << exponent)), 1))  # fraction in 0.5..1
    steps = np.rint((2 * fraction - 1) * (1 << mantissa)).astype(
        np.int64
    )  # may carry into the exponent, which is right
    return (1 - power.astype(np.int64) << mantissa) + np.where(steps >> mantissa, -(1 << mantissa), steps)


def _float(bits: NDArray[np.int64], mantissa: int, exponent: int) -> Doubles:
    values: Doubles = (1 + (bits & (1 << mantissa) - 1) / (1 << mantissa)) * np.exp2(
        -(bits >> mantissa & (1 << exponent) - 1)
    )
    return values


_KEPT = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # the parts that stay, by the one left out
