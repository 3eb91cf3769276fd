"""From where a picture is taken."""

from dataclasses import dataclass

from treebake.model import Doubles


@dataclass(frozen=True, eq=False)
class View:
    """Where from and how large: a square picture.

    to_clip: (4, 4) float64, takes a world position (column) to OpenGL clip space, whose w is the depth along the
    optical axis. size: pixels a side. near, far: the depths between which it sees.
    """

    to_clip: Doubles
    size: int
    near: float
    far: float


def column_major(matrix: Doubles) -> tuple[float, ...]:
    """A matrix as OpenGL takes it."""
    return tuple(matrix.T.ravel().tolist())
