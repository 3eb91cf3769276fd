"""FORMAT.md says what is true: its examples are parsed, its schema is the code's."""

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import treebake
from treebake.asset import Manifest
from treebake.asset.extras import Extras, extras_schema
from treebake.asset.forest import CELLS, TABLES
from treebake.gl.indirect import FADE
from treebake.lookup import LIST_BITS
from treebake.placements import unpack
from treebake.stages.indirect.lists import in_rows

ASSET = Path(treebake.__file__).parent / "asset"
EXAMPLES = re.findall(r"```json\n(.*?)```", (ASSET / "FORMAT.md").read_text(), re.DOTALL)


def example(key: str) -> Any:
    (found,) = (parsed for parsed in map(json.loads, EXAMPLES) if key in parsed)
    return found


def section(heading: str) -> str:
    return (ASSET / "FORMAT.md").read_text().split(f"## {heading}\n")[1].split("\n## ")[0]


def test_the_manifest_of_the_example_is_one() -> None:
    assert msgspec.convert(example("generator"), Manifest).indirect is not None


def test_the_extras_of_the_example_are_some() -> None:
    (found,) = (parsed for parsed in map(json.loads, EXAMPLES) if "hash_width" in parsed.get("indirect", {}))
    assert msgspec.convert(found, Extras).format == 1


def test_the_forest_of_the_example_is_one_and_names_every_key() -> None:
    told = example("forest")
    found = json.loads(msgspec.json.encode(msgspec.convert(told, Extras)))
    assert found["forest"] == told["forest"]
    rows = re.findall(r"^\| `(\w+)` \| (\w+) (float|uint\d+) \|", section("Forests: scene.glb"), re.MULTILINE)
    kinds = {"float": "f4", "uint16": "u2", "uint32": "u4"}
    widths = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
    assert {name: (kinds[kind], widths[shape]) for name, shape, kind in rows} == TABLES | CELLS


def test_the_worked_placement() -> None:
    worked = example("words")
    placed = unpack(np.array([[int(word, 16) for word in worked["words"]]], np.uint32))
    assert np.allclose(placed.positions[0], worked["position"], atol=1 / 65535)
    assert placed.scales[0] * worked["largest"] == pytest.approx(worked["scale"], rel=1e-4)
    assert placed.narrowings[0] == worked["narrowing"]
    assert np.allclose(placed.rotations[0], worked["rotation"], atol=1e-12)
    assert bool(placed.mirrored[0]) is worked["mirrored"]
    assert placed.shape[0] == worked["shape"]


def test_the_worked_addresses() -> None:
    worked = example("words")
    assert in_rows(np.arange(4000))[worked["row"], worked["column"]] == worked["entry"]
    texel = int(worked["hash_texel"], 16)
    assert texel >> LIST_BITS == worked["offset"]
    assert texel & (1 << LIST_BITS) - 1 == worked["count"]


def test_the_fade_is_the_shaders() -> None:
    low, high = FADE
    assert f"clamp((s - {low}) / {high - low}, 0, 1)" in (ASSET / "FORMAT.md").read_text()


def test_the_schema_is_the_codes() -> None:
    assert (ASSET / "extras.schema.json").read_text() == extras_schema()
