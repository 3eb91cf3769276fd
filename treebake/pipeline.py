"""The order of the stages, on one screen.

    load -> split -> occlusion -> translucency -> normals
            -> twigs -> cluster, twice                      `cluster_tree`: a mesh file into the work folder
            -> views, indirect, slicings, billboards, trunk, trunk_maps
            -> hierarchy -> a cloud and a trunk for each level (`levels.py`)
            -> ladder, or smallest -> write_asset           `bake_textures`: the work folder into the published one
    read_asset -> scatter -> write_forest                   `plant_forest`: published folders into one file

The verifier stands apart: it reads published files only.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from typing import TypeVar

import numpy as np

from treebake.asset import (
    SHARED,
    Asset,
    Ladder,
    LeftOut,
    Rung,
    asset_bounds,
    files_of,
    read_asset,
    read_forest,
    write_asset,
    write_forest,
    write_shared_views,
)
from treebake.errors import InputError, SettingsError, WorkspaceError
from treebake.files import cache_folder
from treebake.geometry import join
from treebake.levels import bake_levels, check_levels
from treebake.meshes import read_mesh
from treebake.model import (
    BakedLevel,
    BakedTree,
    BillboardCloud,
    Clusters,
    Floats,
    Forest,
    Hierarchy,
    Impostor,
    IndirectTextures,
    Mesh,
    SlicedFoliage,
    Tree,
    TrunkMaps,
)
from treebake.morph import morph_to_next
from treebake.settings import Settings
from treebake.stages.billboards import billboards
from treebake.stages.cluster import cluster
from treebake.stages.hierarchy import hierarchy
from treebake.stages.indirect import indirect
from treebake.stages.normals import normals
from treebake.stages.occlusion import occlusion
from treebake.stages.scatter import scatter
from treebake.stages.slicings import slicings
from treebake.stages.split import split
from treebake.stages.translucency import TranslucencySettings, translucency
from treebake.stages.trunk import TrunkReport, compare, trunk
from treebake.stages.trunk_maps import trunk_maps
from treebake.stages.twigs import twigs
from treebake.stages.views import views
from treebake.verify import (
    JUDGED,
    SCALE,
    BudgetSettings,
    Change,
    CloseUp,
    Crown,
    LightReport,
    Morphing,
    Report,
    VerifySettings,
    Walk,
    approach,
    cameras,
    check_budget,
    check_ladder,
    check_light,
    close_ups,
    in_full_light,
    ladder,
    morphings,
    pictures_of,
    representations,
    smallest,
    verify,
    walk,
    write_forest_report,
    write_light_report,
    write_report,
)
from treebake.workspace import Result, Workspace

LOG = logging.getLogger("treebake")

T = TypeVar("T", Rung, LeftOut)

_PLAIN, _PARTS = "translucency", "normals"  # the names of the results before normals turn, and before twigs move
_FINE_TEXELS, _OTHER_SEED = 1024, 1  # of the occlusion that a source is judged with
_INDIRECT_CLUSTER = "indirect_cluster"  # the name of the second clustering's result


@dataclass(frozen=True, eq=False)
class Source:
    """What the published asset says of the mesh that it was made from."""

    name: str
    path: str  # of its file, which nothing that is published may replace
    triangles: int
    bounds: Floats  # (2, 3) float32


@dataclass(frozen=True)
class Clustered:
    """What `cluster_tree` left in the work folder."""

    split: Result[Tree]  # with the sky that its vertices see
    tree: Result[Tree]  # after the thin twigs moved into the foliage
    clusters: Result[Clusters] | None  # None where there is no foliage
    indirect_clusters: Result[Clusters] | None


@dataclass(frozen=True)
class Baked:
    """What `bake_textures` published, and how much of the trunk is left, in the finest level and in the others."""

    folder: Path
    trunk: TrunkReport
    silhouettes_kept: tuple[float, ...]
    trunk_maps: TrunkMaps  # of the finest level


def cluster_tree(path: Path, work: Workspace, settings: Settings) -> Clustered:
    """Read a tree, split it and gather its leaves into planes.

    Raises InputError, SettingsError and WorkspaceError.
    """
    _spare(path, work.folder, path.stem)
    with work.announce("load"):
        mesh = replace(read_mesh(path, settings.load), morph=None)  # a level may be a source too
    parts = work.run(split, settings.split, Result.of(mesh))
    parts = work.run(occlusion, settings.occlusion, parts)
    parts = work.run(translucency, settings.translucency, parts)
    parts = work.run(normals, settings.normals, parts)
    tree = work.run(twigs, settings.twigs, parts)
    clusters = indirect_clusters = None
    if tree.value.leaves.count:
        leaves = tree.part("leaves")
        clusters = work.run(cluster, settings.cluster, leaves)
        indirect_clusters = work.run(cluster, settings.indirect_cluster, leaves, name=_INDIRECT_CLUSTER)
    about = Source(path.stem, str(path.resolve()), mesh.triangles, mesh.bounds)
    work.keep("source", about)  # last: make takes its date for the folder's
    return Clustered(parts, tree, clusters, indirect_clusters)


def bake_textures(work: Workspace, out: Path | None, settings: Settings) -> Baked:
    """Bake the clusters of a work folder into every representation, and publish them.

    The asset goes to OUT/NAME, or into the work folder itself where `out` is None.
    Raises WorkspaceError where `cluster_tree` has not been run, BudgetError, GraphicsError and SettingsError.
    """
    _check_what_comes_last(settings)
    source = _source(work)
    folder = out / source.name if out else work.folder
    _spare(Path(source.path), folder, source.name)
    tree = work.read("twigs", _command(work))
    impostor = None
    if settings.views.enabled:
        impostor = work.run(views, settings.views, Result.together([tree])).value[0]
    return _publish(work, _baked(work, settings, impostor), folder, None, settings)


def bake_shared(works: Sequence[Workspace], out: Path, settings: Settings) -> list[Baked]:
    """Bake several work folders as `bake_textures` does, into OUT/NAME each, their views into one atlas that all share.

    Raises what `bake_textures` raises, and SettingsError where two trees have the same name or views are not baked.
    """
    _check_what_comes_last(settings)
    names = distinct_names(works)
    if SHARED in names:
        raise SettingsError(f"a tree is named {SHARED}, as the folder of what the trees share; rename its file")
    if not settings.views.enabled:
        raise SettingsError("--shared-atlas is for views, and views.enabled is false; leave out one of them")
    for work, name in zip(works, names, strict=True):
        _spare(Path(_source(work).path), out / name, name)
    trees = Result.together([work.read("twigs", _command(work)) for work in works])
    gathered = Workspace(out / SHARED, works[0].force, works[0].announce)
    impostors: tuple[Impostor, ...] = gathered.run(views, settings.views, trees).value
    baked = [_baked(work, settings, impostor) for work, impostor in zip(works, impostors, strict=True)]
    shared = write_shared_views(list(zip(names, impostors, strict=True)), out)  # from here on nothing can fail to bake
    beside = Path("..") / shared.relative_to(out)
    return [
        _publish(work, tree, out / name, beside, settings) for work, tree, name in zip(works, baked, names, strict=True)
    ]


def distinct_names(works: Sequence[Workspace]) -> list[str]:
    """The names of the trees in the work folders. Raises SettingsError where two are the same."""
    names = [_source(work).name for work in works]
    if twice := {name for name in names if names.count(name) > 1}:
        raise SettingsError(f"two trees are named {min(twice)}; rename one of the files: each has a folder in OUT")
    return names


def _check_what_comes_last(settings: Settings) -> None:
    """Refuse before the bake what would else be refused after it. Raises SettingsError."""
    if settings.budget != BudgetSettings():
        check_budget(settings.budget)
    if settings.ladder.enabled:
        check_ladder(settings.ladder)
    if settings.levels.enabled:
        check_levels(settings)


def _baked(work: Workspace, settings: Settings, impostor: Impostor | None) -> BakedTree:
    """Run what is left of the stages."""
    source, command = _source(work), _command(work)
    parts, tree = work.read(_PARTS, command), work.read("twigs", command)
    layers: IndirectTextures | None = None
    sliced: SlicedFoliage | None = None
    planes: Result[Hierarchy] | None = None
    if tree.value.leaves.count:
        leaves = tree.part("leaves")
        if settings.indirect.enabled:  # before the atlas, the slowest: they may find that something does not fit
            thick_planes = work.read(_INDIRECT_CLUSTER, command, leaves)
            plain, own = work.read(_PLAIN, command), tree
            if plain.digest != parts.digest:  # a leaf's image is shared by leaves whose normals turn otherwise
                own = work.run(twigs, settings.twigs, plain, name="indirect_twigs")
            layers = work.run(indirect, settings.indirect, own, thick_planes).value
        if settings.slicings.enabled:
            sparse = work.run(twigs, settings.slicing_twigs, parts, name="slicing_twigs")
            thick = work.run(trunk, settings.slicing_trunk, sparse.part("trunk"), name="slicing_trunk")
            surfaces = thick, sparse.part("trunk"), parts.part("trunk"), Result.of(None)
            mapped = work.run(trunk_maps, settings.trunk_maps, *surfaces, name="slicing_trunk_maps")
            sliced = work.run(slicings, settings.slicings, sparse).value
            sliced = replace(sliced, solid=join(mapped.value.mesh, sliced.solid))
        clusters = work.read("cluster", command, leaves)
        cloud = work.run(billboards, settings.textures, tree, clusters).value
        if settings.levels.enabled:
            planes = work.run(hierarchy, settings.hierarchy, leaves, clusters)
            cloud = morph_to_next(cloud, planes.value, 0)
    else:
        cloud = BillboardCloud(tree.value.foliage, np.zeros(0, np.int32))
    solid = work.run(trunk, settings.trunk, tree.part("trunk"))
    surfaces = solid, tree.part("trunk"), parts.part("trunk"), Result.of(None)
    finest = work.run(trunk_maps, settings.trunk_maps, *surfaces).value
    return BakedTree(
        name=source.name,
        cloud=cloud,
        indirect=layers,
        trunk=finest.mesh,
        trunk_maps=finest.maps,
        slicings=sliced,
        views=impostor,
        source_triangles=source.triangles,
        source_bounds=source.bounds,
        levels=bake_levels(work, settings, parts, tree, planes, finest) if settings.levels.enabled else (),
        translucency=parts.value.translucency,
    )


def _publish(work: Workspace, baked: BakedTree, folder: Path, shared: Path | None, settings: Settings) -> Baked:
    """Measure the asset, publish it, and tell what is left of the trunk."""
    command = _command(work)
    parts: Result[Tree] = work.read(_PARTS, command)
    published, measured = _measured(work, baked, parts, settings)
    if shared and measured:  # the draft had the views beside it
        measured = _with_views_in(measured, shared.as_posix())
    with work.announce("asset"):
        write_asset(published, folder, shared, measured)
    tree: Tree = work.read("twigs", command).value
    pieces = tree.foliage.select(tree.leaves.is_twig[tree.leaves.face_leaf])
    finest = compare(parts.value.trunk, baked.trunk, pieces)
    return Baked(folder, finest, tuple(level.silhouette_kept for level in baked.levels), baked.trunk_maps)


def _measured(
    work: Workspace, baked: BakedTree, parts: Result[Tree], settings: Settings
) -> tuple[BakedTree, Ladder | None]:
    """What to publish of a tree, and its ladder: measured on the files of a draft, which an interrupt leaves alone."""
    within_budget = settings.budget != BudgetSettings()
    if not within_budget and not settings.ladder.enabled:
        return baked, None
    draft = work.folder / "stages" / "draft"
    try:
        with work.announce("draft"):
            write_asset(baked, draft)
        asset = read_asset(draft)
        files = Result.of_files([draft / file for file in files_of(asset.manifest)], lambda: asset)
        source = Result(f"{parts.digest}.whole", lambda: join(parts.value.trunk, parts.value.foliage))
        if not within_budget:
            found: Ladder = work.run(ladder, settings.ladder, files, source).value
            for rung in found.rungs:
                _warn_if_seen(rung, "on the ladder")
            return baked, found
        kept: Rung = work.run(smallest, settings.budget, files, source, name="budget").value
    finally:
        rmtree(draft, ignore_errors=True)
    _warn_if_seen(kept, f"within the budget at {settings.budget.height} px")
    return _only(baked, kept, asset.level_number(settings.budget.height))


def _with_views_in(measured: Ladder, file: str) -> Ladder:
    def moved(each: T) -> T:
        return replace(each, file=file) if each.representation == "views" else each

    return Ladder(tuple(map(moved, measured.rungs)), tuple(map(moved, measured.left_out)), measured.level_heights)


def _only(baked: BakedTree, kept: Rung, level: int) -> tuple[BakedTree, Ladder]:
    """What is kept of a tree within a budget: one representation, and one standard level.

    level: the standard level to keep beside what no standard viewer draws, unless that needs its trunk.
    """
    tables = kept.representation in ("leaves", "indirect")
    number = kept.level if kept.level is not None else 0 if tables else level
    one = (BakedLevel(baked.cloud, baked.trunk, 0, trunk_maps=baked.trunk_maps), *baked.levels)[number]
    only = replace(
        baked,
        cloud=replace(one.cloud, mesh=replace(one.cloud.mesh, morph=None)),
        trunk=one.trunk,
        trunk_maps=one.trunk_maps,
        levels=(),
        indirect=baked.indirect if tables else None,
        slicings=baked.slicings if kept.representation == "slicings" else None,
        views=baked.views if kept.representation == "views" else None,
    )
    if kept.level is not None:
        kept = replace(kept, level=0, file=f"{baked.name}_LOD0.glb")
    return only, Ladder((kept,), (), (0,))


def _warn_if_seen(kept: Rung, where: str) -> None:
    if kept.flip_ratio > 1:
        LOG.warning(
            "%s %s is not invisible: its FLIP is %.2f times floor(1 px), and nothing else does better",
            kept.representation,
            where,
            kept.flip_ratio,
        )


def _command(work: Workspace) -> str:
    """What makes the work folder."""
    return f"treebake cluster TREE -o {work.folder}"


def _source(work: Workspace) -> Source:
    source: Source = work.read("source", _command(work)).value
    return source


def _spare(source: Path, folder: Path, name: str) -> None:
    """Refuse to publish over the source itself."""
    for target in folder.glob("*.glb") if source.exists() else ():
        if (target.stem == name or target.stem.startswith(f"{name}_")) and target.samefile(source):
            raise WorkspaceError(f"{target} is the source and would be replaced; give another folder with -o")


def plant_forest(folders: Sequence[Path], path: Path, settings: Settings) -> tuple[Forest, list[Asset]]:
    """Scatter published assets and write the forest as one file.

    Raises AssetError, InputError, SettingsError and WorkspaceError.
    """
    assets = [read_asset(folder) for folder in folders]
    names = [asset.manifest.name for asset in assets]
    if twice := {name for name in names if names.count(name) > 1}:
        raise SettingsError(f"two assets are named {min(twice)}; give each species once, under a name of its own")
    sizes = {name: asset_bounds(asset) for name, asset in zip(names, assets, strict=True)}
    forest = scatter(sizes, settings.forest)
    write_forest(path, forest, assets)
    return forest, assets


def verify_forest(
    path: Path, sources: Sequence[Path], report: Path | None, settings: Settings, progress: Callable[[int, int], None]
) -> tuple[Walk, dict[str, tuple[Change, ...]], Path]:
    """Walk through a forest, once drawn by the ladders of its assets and once as the sources of its species.

    sources: a mesh file for each species, named as it is. The report goes into `report`, or else beside the forest.
    Returns what was found on the way, what someone sees who walks up to a tree of each species, and the folder.
    Raises InputError, AssetError, GraphicsError, SettingsError and WorkspaceError.
    """
    forest, folders = read_forest(path)
    assets = {name: read_asset(folder) for name, folder in zip(forest.names, folders, strict=True)}
    meshes = {}
    for source in sources:
        if source.stem not in assets or source.stem in meshes:
            what = "is given twice" if source.stem in meshes else f"is no species of {path}"
            raise SettingsError(f"--source {source} {what}; give one file for each of {', '.join(assets)}")
        meshes[source.stem] = read_mesh(source, settings.load)
        _warn_of_another_source(meshes[source.stem], source, assets[source.stem])
    found = walk(forest, assets, meshes, settings.walk, progress)
    changes = {name: approach(assets[name], meshes[name]) for name in forest.names}
    folder = report or path.parent / f"{path.stem}_report"
    write_forest_report(found, changes, folder)
    return found, changes, folder


def inspect_tree(path: Path, settings: Settings) -> tuple[Mesh, Tree]:
    """Read a tree and split it, keeping nothing. Raises InputError and SettingsError."""
    mesh = read_mesh(path, settings.load)
    return mesh, split(mesh, settings.split)


def verify_asset(
    candidate: Path, source: Path, report: Path | None, settings: Settings, progress: Callable[[int, int], None]
) -> tuple[dict[str, Report], Path]:
    """Judge a published asset (its folder) or anyone's mesh file against its source, and write the report.

    Of an asset every representation is judged: the cloud (at each height the level that the manifest names for it), the
    same with a texture no larger than the indirect ones, and the indirect textures. settings.load is about the source;
    a mesh file is read as it is. The report goes into `report`, or else beside what it judges. Returns a report per
    representation, and the folder. Raises InputError, AssetError, GraphicsError, SettingsError and WorkspaceError.
    """
    if not candidate.exists():
        raise InputError(f"{candidate} does not exist; check the path")
    mesh, tree = inspect_tree(source, settings)
    heights = {*settings.verify.heights, 256}  # 256 is what a quick run draws
    if candidate.is_dir():
        asset = read_asset(candidate)
        _warn_of_another_source(mesh, source, asset)
        judged = representations(asset, heights, settings.verify)
        folder = report or candidate / "report"
    else:
        if settings.verify.representations:
            LOG.warning("verify.representations is about assets; %s is drawn as a stock client draws it", candidate)
        judged = {"candidate": (dict.fromkeys(heights, read_mesh(candidate)), None)}
        folder = report or candidate.parent / f"{candidate.stem}_report"
    close = _close_ups(tree, settings.verify)
    found = {}
    for number, (name, (meshes, layers)) in enumerate(judged.items()):

        def advance(done: int, total: int, before: int = number) -> None:
            progress(before * total + done, len(judged) * total)

        found[name] = verify(
            mesh,
            meshes,
            settings.verify if name in JUDGED else replace(settings.verify, thresholds={}),
            cache_folder(),
            layers=layers,
            trunk=tree.trunk,
            close=close,
            progress=advance,
        )
    if "cloud" in found and settings.verify.morph and not settings.verify.quick:
        found["cloud"] = replace(found["cloud"], morphs=_morphings(mesh, read_asset(candidate), settings.verify))
    write_report(found, folder)
    return found, folder


def verify_light(
    folder: Path, source: Path, report: Path | None, settings: Settings, progress: Callable[[int, int], None]
) -> tuple[dict[str, LightReport], Path]:
    """Judge how every representation of a published asset takes light, each at the height that settings.light names.

    The report goes into `report`, or else into the asset's own folder. Returns a report per representation, and the
    folder. Raises InputError, AssetError, GraphicsError, SettingsError and WorkspaceError.
    """
    check_light(settings.light)
    asset = read_asset(folder)
    mesh, tree = inspect_tree(source, settings)
    _warn_of_another_source(mesh, source, asset)
    heights = settings.light.heights
    asked = settings.verify.representations or tuple(heights)
    wanted = tuple(name for name in asked if name in heights)
    if not wanted:
        raise SettingsError(
            f"--light judges {', '.join(heights)}, and verify.representations names none of them but {', '.join(asked)}"
        )
    judged = representations(asset, set(heights.values()), replace(settings.verify, representations=wanted))
    views = cameras(mesh, settings.verify.elevations, settings.verify.azimuths)[SCALE]
    crown, lit = _crown(tree), _in_full_light(tree, asset, settings)
    total, done = len(judged) * pictures_of(len(views), settings.light), 0

    def advance(more: int) -> None:
        nonlocal done
        done += more
        progress(done, total)

    found = {
        name: in_full_light(lit, crown, meshes[heights[name]], layers, heights[name], views, settings.light, advance)
        for name, (meshes, layers) in judged.items()
    }
    into = report or folder / "report"
    write_light_report(found, into)
    return found, into


def _in_full_light(tree: Tree, asset: Asset, settings: Settings) -> Mesh:
    """A source with what its vertices see of the sky, more finely than it was baked with, and the light through leaves
    that was published.
    """
    looked = replace(settings.occlusion, directions=settings.light.directions, texels=_FINE_TEXELS, seed=_OTHER_SEED)
    published = asset.manifest.translucency
    types = [] if published is None else [kind for kind in ("broad", "needle") if kind in published.origin]
    through = TranslucencySettings(published is not None, types[0] if len(types) == 1 else "auto")
    lit = translucency(occlusion(tree, looked), through)
    return join(lit.trunk, lit.foliage)


def _crown(tree: Tree) -> Crown | None:
    leaves = ~tree.leaves.is_twig
    return Crown(tree.foliage, 2 * float(np.median(tree.leaves.radii[leaves]))) if leaves.any() else None


def _morphings(source: Mesh, asset: Asset, settings: VerifySettings) -> tuple[Morphing, ...]:
    """How each level goes over into the next, in a third of the views."""
    views = cameras(source, settings.elevations, settings.azimuths)[SCALE]
    heights = [level.min_height for level in asset.manifest.levels]
    levels = list(zip(map(read_mesh, asset.level_paths), heights, strict=True))
    return morphings(source, levels, views, settings.morph, cache_folder())


def _close_ups(tree: Tree, settings: VerifySettings) -> tuple[CloseUp, ...]:
    """Where to look at the crown from close up: a third of the views; none where there are no leaves."""
    leaves = ~tree.leaves.is_twig
    if not leaves.any():
        return ()
    leaf = 2 * float(np.median(tree.leaves.radii[leaves]))
    return close_ups(tree.foliage, leaf, settings.elevations, settings.azimuths)[SCALE]


def _warn_of_another_source(mesh: Mesh, path: Path, asset: Asset) -> None:
    known = asset.manifest.source
    size = float(np.ptp(mesh.bounds, axis=0).max())
    if mesh.triangles == known.triangles and np.allclose(mesh.bounds, known.bounds, rtol=0, atol=1e-4 * size):
        return
    what = "triangles" if mesh.triangles != known.triangles else "bounds"
    LOG.warning(
        "%s is not the mesh that %s was baked from (%s differ); give the same file and --up", path, asset.folder, what
    )
