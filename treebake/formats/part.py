"""What every reader hands back, and how a reader finds the files named in its file."""

import logging
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from treebake.errors import InputError
from treebake.images import read_image
from treebake.model import Floats, Ints, Material, Morph, Texture

LOG = logging.getLogger("treebake")


@dataclass(frozen=True, eq=False)
class Part:
    """The triangles of one node that share one material, in the file's frame, unchecked.

    positions: (V, 3) float32. normals: (V, 3) float32 or None where the file has none; a row of NaN is missing too.
    uvs: (V, 2) float32, v downwards, or None. faces: (F, 3) int32, may be out of range. material: None where the file
    names none. morph: of the vertices, where the file has one that is read; normals are then not None. occlusion_uvs:
    (V, 2) float32, where the occlusion map is placed otherwise than by `uvs`.
    """

    node: str
    material: Material | None
    positions: Floats
    normals: Floats | None
    uvs: Floats | None
    faces: Ints
    morph: Morph | None = None
    occlusion_uvs: Floats | None = None


def beside(path: Path, uri: str, way_out: str = "") -> Path:
    """The path of a file that `path` names by a relative URI: percent-decoded, either slash.

    Raises InputError where the URI is remote, absolute or leaves the folder of `path`; way_out: what else to do then.
    """
    relative = Path(unquote(uri).replace("\\", "/"))
    if not relative.parts or relative.is_absolute() or ".." in relative.parts or ":" in relative.parts[0]:
        raise InputError(
            f"{path} refers to {uri}, outside its own folder; put that file beside it and name it so{way_out}"
        )
    return path.parent / relative


def texture_beside(path: Path, uri: str) -> Texture | None:
    """Read the image that `path` names by a URI; None, and a warning, where it is missing or damaged.

    Raises InputError as `beside` does.
    """
    file = beside(path, uri, ", or assign another to its material with load.textures")
    try:
        return Texture(file.stem, read_image(file))
    except InputError as error:
        LOG.warning("%s: %s; going on without this texture", path, error)
        return None
