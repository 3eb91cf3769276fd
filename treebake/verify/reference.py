"""The source's pictures, and the scale to read a candidate's scores by: the floors and the empty scene.

The source is drawn as it is meant, its leaves cut out exactly, and the candidate as a stock client will draw it. A
floor is the source against itself, the picture shifted by a fraction of a pixel: what something identical but not
pixel-locked would score.
"""

import hashlib
import logging
import zipfile
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treebake.errors import WorkspaceError
from treebake.files import atomic
from treebake.gl.draw import Drawing, renderer
from treebake.gl.target import Picture
from treebake.model import Doubles, Floats, Mesh
from treebake.verify.cameras import Camera, CloseUp
from treebake.verify.metrics import Scores, score, score_all

LOG = logging.getLogger("treebake")

_PACKAGE = Path(__file__).parents[1]
_CODE = (
    "images.py",
    "gl/draw.py",
    "gl/instances.py",
    "gl/light.py",
    "gl/target.py",
    "gl/view.py",
    "gl/shaders/fade.glsl",
    "gl/shaders/grove.glsl",
    "gl/shaders/lighting.glsl",
    "gl/shaders/lit.glsl",
    "gl/shaders/normal_map.glsl",
    "gl/shaders/samples.glsl",
    "verify/cameras.py",
    "verify/metrics.py",
    "verify/reference.py",
)
_KEPT = 2**31  # bytes of cache
_SCORES = ("floor_one", "floor_half", "empty")
SCALE = slice(None, None, 3)  # every third camera: of 24, 8 that hold all elevations and azimuths


@dataclass(frozen=True, eq=False)
class Reference:
    """One height's views of the source.

    colors: (n, h, w, 4) float16 and depths: (n, h, w) float32, as in Picture. area, trunk_area: (n,) float64, pixels
    that the source covers, and that its trunk would cover without leaves. fragments: (n,) float64. floor_one,
    floor_half, empty: the scores of the source shifted by 1 and 0.5 pixels, and of an empty scene; the latter two,
    which only give the reader a scale, in the views SCALE alone.
    """

    colors: NDArray[np.float16]
    depths: Floats
    area: Doubles
    trunk_area: Doubles
    fragments: Doubles
    floor_one: Scores
    floor_half: Scores
    empty: Scores

    def picture(self, view: int) -> Picture:
        """The source in one view."""
        return Picture(self.colors[view].astype(np.float32), self.depths[view])


def reference(
    source: Mesh,
    trunk: Mesh | None,
    cameras: Sequence[Camera | CloseUp],
    height: int,
    cache: Path | None,
    scored: Callable[[int], None],
) -> Reference:
    """Draw and score the source from every camera, its bounding sphere (of a close-up the window) `height` pixels high.

    With a cache folder the result is read from there where mesh, cameras, renderer and code are the ones it was made
    with, and left there otherwise, if it can be written. Its least recently used files go where it grows beyond 2 GiB.
    trunk: the part of the source that is not foliage. `scored` is told how many more views are done. Raises
    GraphicsError.
    """
    path = cache / f"source_{_key(source, trunk, cameras, height)}.npz" if cache else None
    if path and (kept := _read(path)):
        scored(len(cameras))
        return kept
    made = _draw(source, trunk, cameras, height, scored)
    if path:
        _write(path, made)
    return made


def _draw(
    source: Mesh, trunk: Mesh | None, cameras: Sequence[Camera | CloseUp], height: int, scored: Callable[[int], None]
) -> Reference:
    views = [camera.view(height) for camera in cameras]
    with closing(Drawing(source, exact_cutouts=True)) as drawing:
        pictures = [drawing.picture(view) for view in views]
        fragments = np.array([drawing.fragments(view) for view in views])

        def floor(source: Picture, one: Picture) -> Scores:
            result = score(source, one)
            scored(1)
            return result

        def moved(picture: Picture, camera: Camera | CloseUp) -> Picture:
            if picture.color[:, [0, -1]].any():
                return drawing.picture(camera.view(height, shift=1.0))
            # A whole pixel's shift moves the same samples on, and the margins are empty: no need to draw again.
            return Picture(np.roll(picture.color, 1, axis=1), np.roll(picture.depth, 1, axis=1))

        def nothing(source: Picture) -> Scores:
            return score(source, Picture(np.zeros_like(source.color), np.zeros_like(source.depth)))

        shifted = (drawing.picture(camera.view(height, shift=0.5)) for camera in cameras[SCALE])
        floor_one = score_all(floor, pictures, map(moved, pictures, cameras))
        floor_half = score_all(score, pictures[SCALE], shifted)
        empty = score_all(nothing, pictures[SCALE])
    trunk_area = np.zeros(len(views))
    if trunk is not None:
        with closing(Drawing(trunk, exact_cutouts=True)) as drawing:
            trunk_area = np.array([_area(drawing.picture(view)) for view in views])
    return Reference(
        colors=np.stack([picture.color for picture in pictures]).astype(np.float16),
        depths=np.stack([picture.depth for picture in pictures]),
        area=np.array([_area(picture) for picture in pictures]),
        trunk_area=trunk_area,
        fragments=fragments,
        floor_one=floor_one,
        floor_half=floor_half,
        empty=empty,
    )


def _area(picture: Picture) -> float:
    return float(picture.color[..., 3].sum(dtype=np.float64))


def _key(source: Mesh, trunk: Mesh | None, cameras: Sequence[Camera | CloseUp], height: int) -> str:
    digest = hashlib.sha256(renderer().encode())
    for name in _CODE:
        digest.update((_PACKAGE / name).read_bytes())
    for camera in cameras:
        digest.update(camera.view(height).to_clip.tobytes())
    for mesh in (source, trunk):
        if mesh is not None:
            _hash_mesh(digest, mesh)
    return digest.hexdigest()


def _hash_mesh(digest: "hashlib._Hash", mesh: Mesh) -> None:
    for array in (mesh.positions, mesh.normals, mesh.uvs, mesh.faces, mesh.face_material):
        digest.update(repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    for material in mesh.materials:
        factors = (material.base_color, material.alpha_mode.value, material.alpha_cutoff, material.double_sided)
        digest.update(repr(factors).encode())
        for texture in (material.color_map, material.normal_map):
            pixels = texture.pixels if texture else np.zeros((0, 0, 4), np.uint8)
            digest.update(repr(pixels.shape).encode() + pixels.tobytes())


_FIELDS = tuple(field.name for field in fields(Reference))


def _read(path: Path) -> Reference | None:
    damage = OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile
    with suppress(*damage), path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        values: dict[str, Any] = {name: Scores(*file[name]) if name in _SCORES else file[name] for name in _FIELDS}
        with suppress(OSError):
            path.touch()  # used now
        return Reference(**values)
    return None  # a damaged file is simply made again


def _write(path: Path, made: Reference) -> None:
    values = {name: getattr(made, name) for name in _FIELDS}
    arrays: dict[str, Any] = {
        name: np.stack(astuple(value)) if name in _SCORES else value for name, value in values.items()
    }
    try:
        with atomic(path) as file:
            np.savez(file, **arrays)
    except WorkspaceError:
        LOG.info("verify: %s cannot be written, so the source is drawn anew each time; make it writable", path.parent)
        return
    with suppress(OSError):  # another run may be at it too
        _prune(path.parent)


def _prune(cache: Path) -> None:
    """Remove the files that were not used for longest, all beyond the size that is kept."""
    size = 0
    for path in sorted(cache.glob("source_*.npz"), key=lambda path: path.stat().st_mtime, reverse=True):
        size += path.stat().st_size
        if size > _KEPT:
            path.unlink(missing_ok=True)
