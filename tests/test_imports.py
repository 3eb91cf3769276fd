"""The rules of the house, read from the import statements."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "treebake"
MODULES = sorted(PACKAGE.rglob("*.py"))

# Which rooms each layer may import from, besides itself; a room is the first name below `treebake`.
LAYERS = {
    "ground": {
        "model",
        "errors",
        "geometry",
        "flatten",
        "planes",
        "morph",
        "packing",
        "coverage",
        "checks",
        "placements",
        "lookup",
        "leaf_cards",
        "nearest",
        "resources",
        "files",
        "tubes",
    },
    "services": {
        "images",
        "compression",
        "meshes",
        "formats",
        "glb",
        "gl",
        "pictures",
        "crossed",
        "brightness",
        "unwrap",
    },
    "stages": {"stages"},
    "asset": {"asset"},
    "verify": {"verify"},
    "grow": {"grow"},
    "top": {"settings", "levels", "workspace", "pipeline", "summary", "terminal", "cli", "__main__"},
}
MAY_IMPORT = {
    "ground": set(),
    "services": {"ground"},
    "stages": {"ground", "services"},
    "asset": {"ground", "services"},
    "verify": {"ground", "services", "asset"},
    "grow": {"ground", "services"},
    "top": set(LAYERS),
}
# Where each third-party package may be imported; numpy and scipy are everywhere.
HOMES = {
    "OpenImageIO": {"images"},
    "plyfile": {"formats"},
    "DracoPy": {"formats"},
    "moderngl": {"gl"},
    "fast_simplification": {"stages"},
    "meshoptimizer": {"stages"},
    "msgspec": {"settings", "asset", "verify", "grow"},
    "rectpack": {"pictures"},
    "xatlas": {"unwrap"},
    "click": {"cli"},
    "rich": {"terminal"},
    "numpy": None,
    "scipy": None,
}


def room(module: str) -> str:
    return module.split(".")[1]


def layer(module: str) -> str:
    found = [name for name, rooms in LAYERS.items() if room(module) in rooms]
    assert found, f"{module} is in no layer; add its room to LAYERS"
    return found[0]


def name_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> Iterator[str]:
    """Every imported module, those inside functions too."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: a relative import hides where it leads"
            if node.module == "treebake":
                yield from (f"treebake.{alias.name}" for alias in node.names if alias.name != "__version__")
            else:
                yield str(node.module)


def own(path: Path) -> list[str]:
    return [name for name in imports(path) if name.startswith("treebake.")]


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_run_one_way(path: Path) -> None:
    if path == PACKAGE / "__init__.py":
        assert not own(path)
        return
    here = layer(name_of(path))
    for name in own(path):
        assert layer(name) in MAY_IMPORT[here] | {here}, f"{name_of(path)} ({here}) imports {name} ({layer(name)})"


@pytest.mark.parametrize("path", sorted((PACKAGE / "stages").rglob("*.py")), ids=name_of)
def test_stages_do_not_import_each_other(path: Path) -> None:
    stage = name_of(path).split(".")[2:3]
    for name in own(path):
        assert room(name) != "stages" or name.split(".")[2:3] == stage, f"{name_of(path)} imports {name}"


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_third_party_packages_stay_in_their_service(path: Path) -> None:
    for name in imports(path):
        package = name.split(".")[0]
        if package in HOMES and HOMES[package] is not None:
            assert room(name_of(path)) in HOMES[package], f"{name_of(path)} imports {package}"


def test_every_dependency_has_a_home() -> None:
    import sys

    used = {name.split(".")[0] for path in MODULES for name in imports(path)}
    third_party = used - set(sys.stdlib_module_names) - {"treebake"}
    assert third_party <= set(HOMES), "a new package needs a home in HOMES"
