"""Real trees, from file to score: `treebake bake`, then `treebake verify` of what was published."""

import json
import sys
from pathlib import Path

import pytest
from trees import tree

from treebake import cli

CONFIGS = Path(__file__).parents[1] / "configs"


def treebake(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["treebake", *map(str, arguments)])
    with pytest.raises(SystemExit) as exit_:
        cli.main()
    return int(exit_.value.code or 0)


@pytest.mark.parametrize(
    "name",
    [
        "ez_oak_large.glb",
        "sapling_white_birch.glb",
        "treegen_palm.glb",
        "quaternius_tree_1/Tree_1.obj",
    ],
    ids=["ez_oak", "white_birch", "palm", "quaternius"],
)
def test_foliage_keeps_its_coverage_at_256_pixels(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    source = tree(name)
    options = ["--config", CONFIGS / f"{source.stem}.toml", "--set", 'verify.representations=["cloud"]', "-q"]
    options += [part for table in ("slicings", "views", "ladder") for part in ("--set", f"{table}.enabled=false")]
    assert treebake(monkeypatch, "bake", source, "-o", tmp_path, *options) == 0
    bounds = ("--threshold", "foliage_coverage_min=0.95", "--threshold", "foliage_coverage_max=1.05")
    code = treebake(monkeypatch, "verify", tmp_path / source.stem, "--source", source, "--quick", *options, *bounds)
    assert code == 0, capsys.readouterr().err
    report = json.loads((tmp_path / source.stem / "report/report.json").read_text())
    assert list(report) == ["cloud"]
    assert [height["height"] for height in report["cloud"]["heights"]] == [256]
