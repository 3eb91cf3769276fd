"""The command line: parse, call, report. Nothing here knows how a tree is baked.

Heavy modules are imported inside the commands, so that `treebake --help` answers at once.
"""

import logging
import sys
import traceback
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import treebake
from treebake.errors import TreebakeError
from treebake.terminal import Terminal, say

if TYPE_CHECKING:
    from treebake.settings import Settings

_FILE = click.Path(path_type=Path)
Command = Callable[..., None]


class SettingOption(click.Option):
    """A flag for one setting, whose help and default are those of its settings dataclass."""

    def __init__(self, flag: str, key: str, value: str | None = None) -> None:
        """value: what a flag without a value of its own sets."""
        plain: dict[str, Any] = {"metavar": "VALUE"} if value is None else {"is_flag": True, "flag_value": value}
        super().__init__([key.replace(".", "__"), flag], default=None, **plain)
        self.key, self.value = key, value

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Read the dataclass only when this command's help is asked for."""
        from treebake.settings import keys

        setting = keys()[self.key]
        sets = f"Set to {self.value}: " if self.value else ""
        self.help = f"{sets}{setting.help}  [{self.key}, default: {setting.default}]"
        return super().get_help_record(ctx)


def _setting(flag: str, key: str, value: str | None = None) -> Callable[[Command], Command]:
    def decorate(command: Command) -> Command:
        params: list[click.Parameter] = command.__dict__.setdefault("__click_params__", [])
        params.append(SettingOption(flag, key, value))
        return command

    return decorate


def _talks(command: Command) -> Command:
    """Give a command its Terminal and the flags that shape it."""

    @wraps(command)
    def run(quiet: bool, verbose: bool, as_json: bool, **arguments: Any) -> None:
        command(Terminal(quiet=quiet, verbose=verbose, as_json=as_json), **arguments)

    for option in (
        click.option("-v", "--verbose", is_flag=True, help="Say more about what the stages do."),
        click.option("-q", "--quiet", is_flag=True, help="Print warnings and errors only."),
        click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object on stdout."),
    ):
        run = option(run)
    return run


def _configured(command: Command) -> Command:
    """Give a command its Settings: the files of --config, over them --set, over them the command's own flags."""

    @wraps(command)
    def run(
        terminal: Terminal,
        config: tuple[Path, ...],
        assignments: tuple[str, ...],
        thresholds: tuple[str, ...] = (),
        quick: bool = False,
        **arguments: Any,
    ) -> None:
        from treebake.settings import load_settings, parse_assignments

        flags = {name: value for name, value in arguments.items() if "__" in name}
        pairs = [
            *assignments,
            *(f"{name.replace('__', '.')}={value}" for name, value in flags.items() if value is not None),
            *(f"verify.thresholds.{threshold}" for threshold in thresholds),
            *(["verify.quick=true"] if quick else []),
        ]
        settings = load_settings(config, parse_assignments(pairs))
        command(terminal, settings, **{name: value for name, value in arguments.items() if name not in flags})

    for option in (
        click.option(
            "--set", "assignments", multiple=True, metavar="KEY=VALUE", help="Set any setting, e.g. cluster.seed=7."
        ),
        click.option("--config", multiple=True, type=_FILE, help="TOML file of settings; repeatable, later files win."),
    ):
        run = option(run)
    return _talks(run)


def _bounds(_ctx: click.Context, _param: click.Parameter, thresholds: tuple[str, ...]) -> tuple[str, ...]:
    for threshold in thresholds:
        try:
            float(threshold.partition("=")[2])
        except ValueError:
            raise click.BadParameter(f"{threshold}: its bound is no number; write e.g. flip_ratio.512=1.2") from None
    return thresholds


_work = click.option("-o", "work", required=True, type=_FILE, metavar="WORK", help="Work folder of this tree.")
_force = click.option("--force", is_flag=True, help="Run every stage again, even where nothing has changed.")
_up = _setting("--up", "load.up")
_billboards = _setting("--billboards", "cluster.billboards")
_no_translucency = _setting("--no-translucency", "translucency.enabled", "false")
_atlas = _setting("--atlas", "textures.atlas")
_trunk = _setting("--trunk-triangles", "trunk.triangles")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(treebake.__version__, message="treebake %(version)s")
def cli() -> None:
    """Bake detailed tree meshes into billboard clouds, and prove how good they are.

    \b
    treebake bake oak.glb -o build              everything, into build/oak/
    treebake verify build/oak --source oak.glb  render both, score, write the report
    """


@cli.command(short_help="Grow a procedural tree and write it as GLB.")
@click.argument("species")
@click.option("-o", "output", type=_FILE, metavar="FILE", help="GLB to write.  [default: SPECIES.glb]")
@click.option(
    "--seed", default=0, show_default=True, help="Another seed is another tree; the same seed the same bytes."
)
@click.option("--leaves", type=click.IntRange(1, 1_000_000), help="Leaves to grow.  [default: the species' own]")
@_talks
def grow(terminal: Terminal, species: str, output: Path | None, seed: int, leaves: int | None) -> None:
    """Grow a procedural tree and write it as GLB.

    SPECIES is one of chestnut, oak, cork, horse-chestnut, shrub, maple, alder.
    """
    from treebake.glb import write_glb
    from treebake.grow import grow as grow_tree
    from treebake.summary import of_mesh

    path = output or Path(f"{species}.glb")
    _is_glb(path, "tree")
    with terminal.announce("grow"):
        mesh = grow_tree(species, seed=seed, leaves=leaves)
        write_glb(path, [(species, mesh)])
    terminal.show({"file": str(path), **of_mesh(mesh)})


@cli.command(short_help="Split a tree and gather its leaves into planes.")
@click.argument("tree", type=_FILE)
@_work
@_billboards
@_no_translucency
@_up
@_force
@_configured
def cluster(terminal: Terminal, settings: "Settings", tree: Path, work: Path, force: bool) -> None:
    """Split TREE into trunk and leaves and gather the leaves into planes, into the folder WORK.

    TREE is a GLB, glTF, OBJ or PLY file.
    """
    from treebake.pipeline import cluster_tree
    from treebake.summary import of_clustered
    from treebake.workspace import Workspace

    done = cluster_tree(tree, Workspace(work, force, terminal.announce), settings)
    terminal.show({"work": str(work), **of_clustered(done)})


@cli.command(short_help="Bake every representation of a clustered tree, publish.")
@click.argument("works", type=_FILE, nargs=-1, required=True, metavar="WORK...")
@click.option("-o", "out", type=_FILE, metavar="OUT", help="Publish into OUT/NAME/.  [default: WORK itself]")
@click.option(
    "--shared-atlas", "shared", is_flag=True, help="Put the views of all trees into one texture, in OUT/shared_views/."
)
@_atlas
@_trunk
@_force
@_configured
def textures(
    terminal: Terminal, settings: "Settings", works: tuple[Path, ...], out: Path | None, shared: bool, force: bool
) -> None:
    """Bake each clustered WORK folder: atlas, indirect textures, slicings, views, trunk; and publish the assets."""
    from treebake.pipeline import bake_shared, bake_textures, distinct_names
    from treebake.summary import of_baked
    from treebake.workspace import Workspace

    folders = [Workspace(work, force, terminal.announce) for work in works]
    if shared:
        if out is None:
            raise click.UsageError("--shared-atlas needs a folder for what the trees share; name it with -o OUT")
        baked = bake_shared(folders, out, settings)
    else:
        if out:
            distinct_names(folders)
        baked = [bake_textures(work, out, settings) for work in folders]
    facts = [{"asset": str(each.folder), **of_baked(each)} for each in baked]
    if terminal.as_json and len(facts) > 1:
        terminal.show({"assets": facts})
    else:
        for fact in facts:
            terminal.show(fact)


@cli.command(short_help="Mesh in, published asset out: cluster and textures in one.")
@click.argument("tree", type=_FILE)
@click.option(
    "-o", "out", required=True, type=_FILE, metavar="OUT", help="Publish into OUT/NAME/, which keeps the stages too."
)
@_billboards
@_atlas
@_trunk
@_setting("--height", "budget.height")
@_setting("--triangles", "budget.triangles")
@_setting("--bytes", "budget.bytes")
@_no_translucency
@_up
@_force
@_configured
def bake(terminal: Terminal, settings: "Settings", tree: Path, out: Path, force: bool) -> None:
    """Bake TREE from mesh to published asset: `cluster` and `textures` in one.

    TREE is a GLB, glTF, OBJ or PLY file; NAME is its name without the suffix. With --height only the smallest
    representation that is invisible at that height is kept, within the caps of --triangles and --bytes.
    """
    from treebake.pipeline import bake_textures, cluster_tree
    from treebake.summary import of_baked, of_clustered
    from treebake.workspace import Workspace

    work = Workspace(out / tree.stem, force, terminal.announce)
    done = cluster_tree(tree, work, settings)
    baked = bake_textures(work, None, settings)
    terminal.show({"asset": str(baked.folder), **of_clustered(done), **of_baked(baked)})


@cli.command(short_help="Render an asset next to its source and score it.")
@click.argument("asset", type=_FILE, required=False)
@click.option(
    "--source",
    "sources",
    required=True,
    multiple=True,
    type=_FILE,
    metavar="TREE",
    help="The tree that it was baked from; of a forest, one for each species, named as it is.",
)
@click.option("--candidate", type=_FILE, metavar="FILE", help="Judge this GLB, glTF, OBJ or PLY instead of an asset.")
@click.option("--forest", "scene", type=_FILE, metavar="SCENE", help="Walk through this forest instead.")
@click.option("--light", is_flag=True, help="Judge instead how it takes light: other suns, shadows, a day.")
@click.option("-o", "report", type=_FILE, metavar="FOLDER", help="Where the report goes.  [default: ASSET/report]")
@click.option(
    "--threshold",
    "thresholds",
    multiple=True,
    metavar="FIGURE[.HEIGHT]=BOUND",
    callback=_bounds,
    help="Exit 1 where FIGURE (or FIGURE_max) is above BOUND or FIGURE_min below it; e.g. flip_ratio.512=1.2.",
)
@click.option("--quick", is_flag=True, help="A third of the views, at 256 pixels only: for the edit loop.")
@_up
@_configured
def verify(
    terminal: Terminal,
    settings: "Settings",
    asset: Path | None,
    sources: tuple[Path, ...],
    candidate: Path | None,
    scene: Path | None,
    light: bool,
    report: Path | None,
) -> None:
    """Render ASSET (a published or a work folder) next to its source and score it.

    Reads published files only. Exits with 1, naming the figure, where a threshold is missed. With --forest it walks
    through what `treebake forest` wrote, and tells frame by frame how much faster the ladders are and what is seen.
    With --light it lights ASSET by suns that nothing was baked with, and compares shadows and a whole day.
    """
    from treebake.pipeline import verify_asset, verify_forest, verify_light
    from treebake.verify import as_dict, forest_facts, format_forest, format_light, format_table, light_facts

    named = [path for path in (asset, candidate, scene) if path]
    if len(named) != 1:
        raise click.UsageError("name one of: an ASSET folder, a file with --candidate, a forest with --forest")
    if light and asset is None:
        raise click.UsageError("--light is about an ASSET; leave out --candidate and --forest, or --light")
    if scene:
        if settings.verify.thresholds or settings.verify.quick:
            raise click.UsageError("a forest has no thresholds and no --quick; set walk.frames and walk.compared")
        with terminal.announce("verify") as progress:
            walked, changes, folder = verify_forest(scene, sources, report, settings, progress)
        facts = {"report": str(folder), **forest_facts(walked, changes)}
        terminal.show(facts, text=f"{format_forest(walked, changes)}\nreport: {folder}")
        return
    if len(sources) != 1:
        raise click.UsageError("an asset or a candidate has one --source")
    if light and asset:
        if settings.verify.thresholds or settings.verify.quick:
            raise click.UsageError("--light has no thresholds and no --quick; set [light] suns, azimuths and hours")
        with terminal.announce("verify") as progress:
            lit, folder = verify_light(asset, sources[0], report, settings, progress)
        facts = {"report": str(folder), "representations": light_facts(lit)}
        terminal.show(facts, text=f"{format_light(lit)}\n\nreport: {folder}")
        return
    with terminal.announce("verify") as progress:
        found, folder = verify_asset(named[0], sources[0], report, settings, progress)
    facts = {"report": str(folder), "representations": {name: as_dict(of_one) for name, of_one in found.items()}}
    terminal.show(facts, text=f"{format_table(found)}\n\n(= is invisible)  report: {folder}")
    misses = [f"{name.replace('_', ' ')}: {miss}" for name, of_one in found.items() for miss in of_one.misses]
    for miss in misses:
        say(f"treebake: missed: {miss}")
    sys.exit(1 if misses else 0)


@cli.command(short_help="Scatter assets into a forest, as one GLB with instances.")
@click.argument("assets", type=_FILE, nargs=-1, required=True, metavar="ASSET...")
@click.option("-o", "output", required=True, type=_FILE, metavar="FILE", help="GLB to write.")
@_setting("--trees", "forest.trees")
@_setting("--seed", "forest.seed")
@_configured
def forest(terminal: Terminal, settings: "Settings", assets: tuple[Path, ...], output: Path) -> None:
    """Scatter trees of each ASSET (a published folder) over the ground, and write them as one GLB with instances."""
    from treebake.pipeline import plant_forest
    from treebake.summary import of_forest

    _is_glb(output, "forest")
    with terminal.announce("forest"):
        planted = plant_forest(assets, output, settings)
    terminal.show(of_forest(output, *planted))


@cli.command(short_help="Say what is in a tree or an asset.")
@click.argument("file", type=_FILE)
@_up
@_configured
def inspect(terminal: Terminal, settings: "Settings", file: Path) -> None:
    """Say what is in FILE: a tree (and how it would be split) or an asset folder."""
    from treebake.pipeline import inspect_tree
    from treebake.summary import of_asset, of_mesh, of_tree

    if file.is_dir():
        terminal.show(of_asset(file))
    else:
        mesh, tree = inspect_tree(file, settings)
        terminal.show({**of_mesh(mesh), **of_tree(tree)})


def _is_glb(path: Path, what: str) -> None:
    if path.suffix.lower() != ".glb":
        raise click.UsageError(f"a {what} is written as GLB; name it {path.with_suffix('.glb')} instead of {path}")


def main() -> None:
    """Run the command line; every error on purpose is one line and exit 2, any other one line and exit 70."""
    try:
        sys.exit(cli(sys.argv[1:] or ["--help"], standalone_mode=False) or 0)
    except click.ClickException as error:
        say(f"treebake: error: {_one_line(error.format_message())}")
        sys.exit(2)
    except TreebakeError as error:
        say(f"treebake: error: {_one_line(error)}")
        sys.exit(2)
    except (KeyboardInterrupt, click.Abort):
        say("treebake: interrupted; nothing is half-written, and the same command goes on where it stopped")
        sys.exit(130)
    except Exception as error:
        if logging.getLogger("treebake").isEnabledFor(logging.DEBUG):
            traceback.print_exc()
        text = _one_line(f"{type(error).__name__}: {error}")
        say(f"treebake: internal error: {text}; run again with -v for the traceback and report it")
        sys.exit(70)


def _one_line(text: object) -> str:
    return " ".join(str(text).split())
