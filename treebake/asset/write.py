"""Write a baked tree as files: NAME_LOD0.glb, NAME.glb, textures/ and manifest.json."""

from pathlib import Path

import msgspec
import numpy as np

from treebake import __version__
from treebake.asset.indirect import IMAGES, TABLES, indirect_bytes, write_indirect
from treebake.asset.manifest import FORMAT, Image, Indirect, Level, Manifest, Source
from treebake.errors import WorkspaceError
from treebake.files import atomic
from treebake.glb import write_glb
from treebake.images import encode_floats, encode_png, encode_texture
from treebake.model import BakedTree, IndirectTextures, Mesh, Texture


def write_asset(tree: BakedTree, folder: Path) -> Manifest:
    """Write every file of the asset into `folder`, each atomically, the manifest last.

    Raises WorkspaceError where a file cannot be written, or where there is nothing to write.
    """
    parts = {"cloud": tree.cloud.mesh, "trunk": tree.trunk}
    nodes = [(name, mesh) for name, mesh in parts.items() if mesh.triangles]
    if not nodes:
        raise WorkspaceError(f"{tree.name} has neither foliage nor trunk left; there is nothing to publish")
    level = folder / f"{tree.name}_LOD0.glb"
    write_glb(level, nodes)
    images = [_write_image(folder, tree.name, texture, space) for texture, space in _maps(tree.cloud.mesh)]
    indirect = None
    if tree.indirect is not None:
        full = folder / f"{tree.name}.glb"
        write_indirect(full, nodes, tree.indirect)
        images += _write_indirect_images(folder, tree.name, tree.indirect)
        indirect = Indirect(
            file=full.name,
            billboards=len(tree.indirect.billboards),
            leaves=tree.indirect.leaves,
            gpu_bytes=indirect_bytes(tree.indirect),
        )
    manifest = Manifest(
        format=FORMAT,
        generator=f"treebake {__version__}",
        name=tree.name,
        source=Source(tree.source_triangles, _corners(tree)),
        levels=(
            Level(
                file=level.name,
                representations=tuple(name for name, _ in nodes),
                billboards=len(set(tree.cloud.face_cluster.tolist())),
                foliage_triangles=tree.cloud.mesh.triangles,
                trunk_triangles=tree.trunk.triangles,
                bytes=level.stat().st_size,
                min_height=0,
            ),
        ),
        indirect=indirect,
        textures=tuple(images),
    )
    with atomic(folder / "manifest.json") as file:
        file.write(msgspec.json.format(msgspec.json.encode(manifest), indent=2) + b"\n")
    return manifest


def _maps(mesh: Mesh) -> list[tuple[Texture, str]]:
    """The textures of the cards, with their colour spaces."""
    if not mesh.triangles:
        return []
    maps = [(mesh.materials[0].color_map, "sRGB"), (mesh.materials[0].normal_map, "linear")]
    return [(texture, space) for texture, space in maps if texture is not None]


def _write_image(folder: Path, name: str, texture: Texture, space: str) -> Image:
    path = folder / "textures" / f"{name}_{texture.name}.png"
    height, width = texture.pixels.shape[:2]
    with atomic(path) as file:
        file.write(encode_texture(texture, with_alpha=texture.has_alpha))
    return Image(path.relative_to(folder).as_posix(), (width, height), space)


def _write_indirect_images(folder: Path, name: str, textures: IndirectTextures) -> list[Image]:
    """The tables and images once more as loose files: floats as EXR, all others as the 16-bit words of a grey PNG."""
    spaces = {image: "sRGB" if image.endswith("color") else "linear" for image in IMAGES}
    written = [_write_image(folder, name, getattr(textures, image), space) for image, space in spaces.items()]
    for table in TABLES:
        values = getattr(textures, table)
        is_float = values.dtype == np.float32
        pixels = values.reshape(len(values), -1, 4) if is_float else values.view(np.uint16).reshape(len(values), -1)
        path = folder / "textures" / f"{name}_{table}.{'exr' if is_float else 'png'}"
        with atomic(path) as file:
            file.write(encode_floats(pixels) if is_float else encode_png(pixels))
        written.append(Image(path.relative_to(folder).as_posix(), (pixels.shape[1], len(pixels)), "data"))
    return written


def _corners(tree: BakedTree) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    low, high = tree.source_bounds.tolist()
    return tuple(low), tuple(high)
