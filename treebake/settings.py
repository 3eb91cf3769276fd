"""TOML files and command-line flags into one frozen `Settings`.

Each stage's own settings dataclass is the single source of its defaults and help: a field's trailing comment gives its
meaning, unit and range, and is what `--help` and `configs/default.toml` show.
"""

import difflib
import inspect
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from treebake.errors import SettingsError
from treebake.levels import LevelSettings
from treebake.meshes import LoadSettings
from treebake.stages.billboards import BillboardSettings
from treebake.stages.cluster import ClusterSettings
from treebake.stages.hierarchy import HierarchySettings
from treebake.stages.indirect import IndirectSettings
from treebake.stages.normals import NormalSettings
from treebake.stages.occlusion import OcclusionSettings
from treebake.stages.scatter import ForestSettings
from treebake.stages.slicings import SlicingSettings
from treebake.stages.split import SplitSettings
from treebake.stages.translucency import TranslucencySettings
from treebake.stages.trunk import TrunkSettings
from treebake.stages.trunk_maps import TrunkMapSettings
from treebake.stages.twigs import TwigSettings
from treebake.stages.views import ViewSettings
from treebake.verify import BudgetSettings, LadderSettings, LightSettings, VerifySettings, WalkSettings

Tables = Mapping[str, Any]  # as TOML nests them: table -> key -> value


def _few_thick_planes() -> ClusterSettings:
    # The indirect textures show leaves off their plane, so planes may be few; compact ones have little empty space.
    return ClusterSettings(billboards=278, angle_weight=1.0, compactness=0.5)


def _most_branches_sliced() -> TwigSettings:
    # A branch on a slice costs nothing ([J00] 2.1), so the trunk beside the slices is for what is thick.
    return TwigSettings(trunk_triangles=5000)


def _thick_branches() -> TrunkSettings:
    return TrunkSettings(triangles=5000)


@dataclass(frozen=True)
class Settings:
    """Everything that can be set, one table per stage."""

    load: LoadSettings = field(default_factory=LoadSettings)
    split: SplitSettings = field(default_factory=SplitSettings)
    occlusion: OcclusionSettings = field(default_factory=OcclusionSettings)
    translucency: TranslucencySettings = field(default_factory=TranslucencySettings)
    normals: NormalSettings = field(default_factory=NormalSettings)
    twigs: TwigSettings = field(default_factory=TwigSettings)
    cluster: ClusterSettings = field(default_factory=ClusterSettings)
    hierarchy: HierarchySettings = field(default_factory=HierarchySettings)
    textures: BillboardSettings = field(default_factory=BillboardSettings)
    indirect_cluster: ClusterSettings = field(default_factory=_few_thick_planes)
    indirect: IndirectSettings = field(default_factory=IndirectSettings)
    trunk: TrunkSettings = field(default_factory=TrunkSettings)
    trunk_maps: TrunkMapSettings = field(default_factory=TrunkMapSettings)
    levels: LevelSettings = field(default_factory=LevelSettings)
    slicing_twigs: TwigSettings = field(default_factory=_most_branches_sliced)
    slicing_trunk: TrunkSettings = field(default_factory=_thick_branches)
    slicings: SlicingSettings = field(default_factory=SlicingSettings)
    views: ViewSettings = field(default_factory=ViewSettings)
    forest: ForestSettings = field(default_factory=ForestSettings)
    ladder: LadderSettings = field(default_factory=LadderSettings)
    budget: BudgetSettings = field(default_factory=BudgetSettings)
    verify: VerifySettings = field(default_factory=VerifySettings)
    light: LightSettings = field(default_factory=LightSettings)
    walk: WalkSettings = field(default_factory=WalkSettings)


@dataclass(frozen=True)
class Key:
    """One setting, e.g. cluster.billboards, as its dataclass declares it."""

    name: str  # "table.key"
    type: Any
    default: Any
    help: str  # meaning, unit and range: the field's comment


def load_settings(paths: Sequence[Path] = (), overrides: Tables | None = None) -> Settings:
    """Merge TOML files, later ones over earlier ones, and `overrides` over all of them; so do the tables in settings.

    trunk.triangles sets twigs.trunk_triangles too, which is the same budget, unless that is set itself; so does
    slicing_trunk.triangles for slicing_twigs.

    Raises SettingsError, naming the file and the key, for a file that cannot be read, an unknown key (with the nearest
    known one) and a value of the wrong type or not finite.
    """
    merged: dict[str, Any] = {}
    for origin, tables in [*((str(path), _read(path)) for path in paths), ("command line", overrides or {})]:
        _check(origin, tables)
        merged = _merge(merged, tables)
    for solid, sparse in (("trunk", "twigs"), ("slicing_trunk", "slicing_twigs")):
        if budget := merged.get(solid, {}).get("triangles"):  # it is the twigs' too, where they have none of their own
            merged = _merge({sparse: {"trunk_triangles": budget}}, merged)
    return msgspec.convert(_merge(msgspec.to_builtins(Settings()), merged), Settings)


def parse_assignments(assignments: Sequence[str]) -> dict[str, Any]:
    """Turn "table.key=value" texts into tables; a value is TOML, or else plain text.

    Raises SettingsError for a text that is no assignment.
    """
    merged: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        for value in (text, msgspec.json.encode(text).decode()):
            with suppress(tomllib.TOMLDecodeError):
                merged = _merge(merged, tomllib.loads(f"{name} = {value}"))
                break
        else:
            equals = ""
        if not equals:
            raise SettingsError(f"{assignment} is no setting; write table.key=value, e.g. cluster.billboards=100")
    return merged


@cache
def keys() -> dict[str, Key]:
    """Every setting by its "table.key" name, in the order of the dataclasses."""
    return {
        name: Key(name, hints[item.name], default, comments.get(item.name, ""))
        for table, settings in _tables().items()
        for hints, comments, defaults in [(get_type_hints(settings), _comments(settings), getattr(Settings(), table))]
        for item in fields(settings)
        for name, default in [(f"{table}.{item.name}", getattr(defaults, item.name))]
    }


def default_toml() -> str:
    """The text of `configs/default.toml`: every key with its default and its comment."""
    lines = ["# Every setting with its default. A file given with --config needs only the keys that it changes."]
    table = ""
    for key in keys().values():
        if not key.name.startswith(f"{table}."):
            table = key.name.split(".")[0]
            lines += ["", f"[{table}]"]
        lines += [f"# {key.help}", f"{key.name.split('.')[1]} = {_toml(key.default)}"]
    return "\n".join(lines) + "\n"


def _tables() -> dict[str, type[Any]]:
    return get_type_hints(Settings)


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path} cannot be read ({error.strerror}); check the path given with --config") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path} is not valid TOML: {error}") from error


def _check(origin: str, tables: Tables) -> None:
    known = keys()
    for table, content in tables.items():
        if table in _tables() and not isinstance(content, dict):
            raise SettingsError(f"{origin}: {table} is a table; set one of its keys, as in {table}.KEY = VALUE")
        if table not in _tables():
            raise SettingsError(f"{origin}: there is no table [{table}]{_nearest(table, _tables())}")
        for name, value in ((f"{table}.{key}", value) for key, value in content.items()):
            if name not in known:
                raise SettingsError(f"{origin}: there is no setting {name}{_nearest(name, known)}")
            if not _finite(value):
                raise SettingsError(f"{origin}: {name} = {value!r}: give a finite number; it means: {known[name].help}")
            try:
                msgspec.convert(value, known[name].type)
            except msgspec.ValidationError as error:
                reason = str(error).replace("`", "")
                raise SettingsError(f"{origin}: {name} = {value!r}: {reason}; it means: {known[name].help}") from error


def _finite(value: Any) -> bool:
    if isinstance(value, dict):
        return all(map(_finite, value.values()))
    if isinstance(value, list):
        return all(map(_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def _merge(under: Tables, over: Tables) -> dict[str, Any]:
    both = {
        key: _merge(under[key], over[key])
        for key in over
        if isinstance(under.get(key), dict) and isinstance(over[key], dict)
    }
    return {**under, **over, **both}


def _nearest(name: str, known: Mapping[str, Any]) -> str:
    same = [key for key in known if key.split(".")[1:] == name.split(".")[1:] != []]  # the right key, the wrong table
    near = same or difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"; did you mean {near[0]}?" if near else f"; known are {', '.join(known)}"


def _comments(settings: type[Any]) -> dict[str, str]:
    """The comment of each field: on its line or, where it is written over several, up to the next field."""
    found: dict[str, str] = {}
    name = ""
    for line in inspect.getsource(settings).splitlines():
        if declared := re.match(r"    (\w+):", line):
            name = declared[1]
        if name and (comment := re.search(r"#\s*(.*)", line)):
            found[name] = f"{found.get(name, '')} {comment[1]}".strip()
    return found


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return msgspec.json.encode(value).decode()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{_toml(k)} = {_toml(v)}' for k, v in value.items())} }}" if value else "{}"
    return repr(value)


if __name__ == "__main__":
    print(default_toml(), end="")
