"""Write a baked tree as files: NAME_LOD0.glb, textures/ and manifest.json."""

from pathlib import Path

import msgspec

from treebake import __version__
from treebake.asset.manifest import FORMAT, Image, Level, Manifest, Source
from treebake.errors import WorkspaceError
from treebake.files import atomic
from treebake.glb import write_glb
from treebake.images import encode_texture
from treebake.model import BakedTree, Mesh, Texture


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
    images = tuple(_write_image(folder, tree.name, texture, space) for texture, space in _maps(tree.cloud.mesh))
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
        textures=images,
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


def _corners(tree: BakedTree) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    low, high = tree.source_bounds.tolist()
    return tuple(low), tuple(high)
