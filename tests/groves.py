"""Trees that stand in groves, and the same put there by hand."""

from contextlib import closing
from dataclasses import replace

import numpy as np

from treebake.geometry import turn_to
from treebake.gl.draw import Drawing
from treebake.gl.scene import Scene, Stand
from treebake.gl.target import Picture
from treebake.gl.view import Grove, View, looking
from treebake.model import Layers, Mesh

Place = tuple[float, float, float, float, float]  # x, y, z, scale, degrees from +Z towards +X

NOBODY = Grove(np.zeros((0, 4), np.float32), np.zeros(0, np.float32))


def standing(*trees: Place, opacities: object | None = None) -> Grove:
    """A grove of trees at those places. opacities: one, or one each."""
    rows = np.array(trees, np.float32)
    shown = None if opacities is None else np.broadcast_to(np.asarray(opacities, np.float32), len(rows)).copy()
    return Grove(rows[:, :4].copy(), np.radians(rows[:, 4]), shown)


def put(mesh: Mesh, place: Place) -> Mesh:
    """The mesh moved, scaled and turned by hand."""
    *at, scale, degrees = place
    turn = turn_to(0.0, degrees)  # a row vector times this is turned from +Z towards +X
    return replace(
        mesh,
        positions=(scale * mesh.positions.astype(np.float64) @ turn + at).astype(np.float32),
        normals=(mesh.normals.astype(np.float64) @ turn).astype(np.float32),
    )


def seen_from_it(view: View, place: Place) -> View:
    """The same view, told in the frame of a tree that stands there."""
    *at, scale, degrees = place
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = scale * turn_to(0.0, degrees).T, at
    return replace(view, to_clip=view.to_clip @ to_world / scale)


def hillside(size: int = 96, *, reach: float = 2.5, aspect: float = 1.0) -> View:
    """Down at the origin from a hill, in perspective. reach: of what is seen, up and down."""
    turn = turn_to(20.0, 35.0)
    return looking(turn, 12.0 * turn[2], 12.0 / reach, (4.0, 40.0), size, 0.0, aspect)


def front(size: int = 64, *, reach: float = 1.0, aspect: float = 1.0) -> View:
    """Straight along -Z at the origin, from so far away that all is seen nearly without perspective."""
    return looking(turn_to(0.0, 0.0), np.array([0.0, 0.0, 50.0]), 50.0 / reach, (30.0, 70.0), size, 0.0, aspect)


def planted(view: View, *stands: tuple[Mesh, Layers | None, Grove]) -> Picture:
    """Stands in one scene, in the order given."""
    with closing(Scene(view.window)) as scene:
        drawings = [Drawing(mesh, layers) for mesh, layers, _ in stands]
        try:
            pairs = zip(drawings, stands, strict=True)
            return scene.picture(view, [Stand(drawing, grove) for drawing, (_, _, grove) in pairs])
        finally:
            for drawing in drawings:
                drawing.close()
