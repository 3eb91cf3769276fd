"""`treebake textures A B --shared-atlas`: two grown trees, their views in one texture."""

import io
import json
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from treebake import cli
from treebake.asset import read_asset, read_views

QUICK = [
    item
    for assignment in (
        "indirect.enabled=false",
        "ladder.heights=[32]",
        "ladder.elevations=[0]",
        "ladder.azimuths=1",
        "levels.enabled=false",
        "slicings.enabled=false",
        "textures.atlas=64",
        "textures.supersample=1",
        'views.layout="ring"',
        "views.count=3",
        "views.layers=1",
        "views.texels=32",
        "views.gutter=2",
        "views.supersample=1",
    )
    for item in ("--set", assignment)
]


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.err.splitlines()


def treebake(*arguments: object) -> Outcome:
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["treebake", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit_:
            cli.main()
    return Outcome(int(exit_.value.code or 0), out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def works(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a.glb and b.glb, clustered into work_a and work_b."""
    folder = tmp_path_factory.mktemp("shared")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        for seed, name in enumerate("ab"):
            assert treebake("grow", "shrub", "--leaves", 60, "--seed", seed, "-o", folder / f"{name}.glb").code == 0
            done = treebake("cluster", folder / f"{name}.glb", "-o", folder / f"work_{name}", "--billboards", 4)
            assert done.code == 0, done.err
        yield folder


@pytest.fixture(scope="module")
def first(works: Path) -> Outcome:
    """Both published into works/out."""
    return treebake(
        "textures", works / "work_a", works / "work_b", "--shared-atlas", "-o", works / "out", *QUICK, "--json"
    )


def test_both_trees_are_published_with_one_texture_of_views(works: Path, first: Outcome) -> None:
    assert first.code == 0, first.err
    out = works / "out"
    assert sorted(path.name for path in out.iterdir()) == ["a", "b", "shared_views"]
    shared = out / "shared_views/shared_views.glb"
    found = []
    for name in "ab":
        asset = read_asset(out / name)
        assert (asset.manifest.name, asset.manifest.indirect, asset.manifest.slicings) == (name, None, None)
        assert asset.manifest.views is not None
        assert (out / name / asset.manifest.views.file).resolve() == shared.resolve()
        assert len(asset.manifest.views.pictures) == 3
        assert not list((out / name).rglob("*views*"))
        found.append(read_views(shared, name))
    np.testing.assert_array_equal(found[0].atlas.coverage.pixels, found[1].atlas.coverage.pixels)
    assert not np.array_equal(found[0].pictures, found[1].pictures)
    assert len(list((out / "shared_views/textures").iterdir())) == 4


def test_what_was_published_is_told_tree_by_tree(works: Path, first: Outcome) -> None:
    facts = json.loads(first.out)
    assert [asset["asset"] for asset in facts["assets"]] == [str(works / "out/a"), str(works / "out/b")]
    for name, told in zip("ab", facts["assets"], strict=True):
        assert (told["name"], told["views"]["file"]) == (name, "../shared_views/shared_views.glb")
        ranked = {each["representation"]: each["file"] for each in told["ladder"] + told.get("left_out", [])}
        assert ranked["views"] == "../shared_views/shared_views.glb"


@pytest.mark.usefixtures("first")
def test_a_second_run_has_nothing_to_do(works: Path) -> None:
    again = treebake("textures", works / "work_a", works / "work_b", "--shared-atlas", "-o", works / "out", *QUICK)
    assert again.code == 0, again.err
    skipped = [line.split()[0] for line in again.lines if line.endswith("up to date")]
    baked = ["billboards", "trunk", "trunk_maps"]
    assert skipped == ["views", *baked, *baked, "ladder", "ladder"]


@pytest.mark.usefixtures("first")
def test_another_tree_among_those_that_share_has_all_photographed_anew(works: Path, tmp_path: Path) -> None:
    # In a folder of its own: the first result is still up to date.
    one = treebake("textures", works / "work_b", "--shared-atlas", "-o", tmp_path, *QUICK, "-q")
    assert one.code == 0, one.err
    ours = read_views(tmp_path / "shared_views/shared_views.glb", "b")
    both = read_views(works / "out/shared_views/shared_views.glb", "b")
    assert ours.atlas.coverage.pixels.size < both.atlas.coverage.pixels.size


@pytest.mark.usefixtures("first")
def test_a_tree_is_verified_by_its_own_views(works: Path) -> None:
    result = treebake(
        "verify",
        works / "out/b",
        "--source",
        works / "b.glb",
        "--quick",
        *("--set", 'verify.representations=["views"]', "--set", "verify.azimuths=1", "--set", "verify.elevations=[0]"),
        *("-o", works / "report", "--json"),
    )
    assert result.code == 0, result.err
    facts = json.loads(result.out)["representations"]
    assert list(facts) == ["views"]
    (level,) = facts["views"]["heights"]
    assert level["iou"] > 0.5  # another tree's views would not meet this
    assert level["triangles"] == 6


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--shared-atlas"], "--shared-atlas needs a folder for what the trees share; name it with -o OUT"),
        (
            ["--shared-atlas", "-o", "OUT", "--set", "views.enabled=false"],
            "--shared-atlas is for views, and views.enabled is false; leave out one of them",
        ),
        (
            ["--shared-atlas", "-o", "OUT", "--set", "views.atlas=64"],
            "6 pictures do not fit into an atlas of 64 texels a side; set [views] atlas = 128, "
            "or lower [views] texels, layers, count or side",
        ),
    ],
    ids=["no folder", "no views", "atlas too small"],
)
def test_called_wrongly_is_one_line_and_publishes_nothing(
    works: Path, tmp_path: Path, arguments: list[str], says: str
) -> None:
    out = tmp_path / "out"
    placed = [str(out) if argument == "OUT" else argument for argument in arguments]
    result = treebake("textures", works / "work_a", works / "work_b", *QUICK, *placed, "-q")
    assert (result.code, result.lines) == (2, [f"treebake: error: {says}"])
    assert not list(out.rglob("manifest.json"))


def test_two_trees_of_one_name_are_one_line(works: Path, tmp_path: Path) -> None:
    result = treebake("textures", works / "work_a", works / "work_a", "--shared-atlas", "-o", tmp_path, *QUICK, "-q")
    says = "treebake: error: two trees are named a; rename one of the files: each has a folder in OUT"
    assert (result.code, result.lines) == (2, [says])
    assert not list(tmp_path.iterdir())


def test_a_folder_that_was_not_clustered_names_the_command(works: Path, tmp_path: Path) -> None:
    result = treebake("textures", works / "work_a", tmp_path, "--shared-atlas", "-o", tmp_path / "out", *QUICK, "-q")
    assert (result.code, len(result.lines)) == (2, 1)
    assert f"treebake cluster TREE -o {tmp_path}" in result.lines[0]
    assert not (tmp_path / "out").exists()


def test_a_tree_with_the_name_of_the_shared_folder_does_not_lose_the_views(works: Path, tmp_path: Path) -> None:
    odd = tmp_path / "shared_views.glb"
    odd.write_bytes((works / "a.glb").read_bytes())
    assert treebake("cluster", odd, "-o", tmp_path / "work", "--billboards", 4, "-q").code == 0
    both = ("textures", tmp_path / "work", works / "work_b", "--shared-atlas", "-o", tmp_path / "out", *QUICK, "-q")
    result = treebake(*both, "--set", "indirect.enabled=true", "--set", "indirect.leaf_texels=8")
    if result.code == 2:  # refused in one line, or published so that all can be read
        assert len(result.lines) == 1
        return
    assert result.code == 0, result.err
    for name in ("shared_views", "b"):
        asset = read_asset(tmp_path / "out" / name)
        assert asset.manifest.views is not None
        read_views(asset.folder / asset.manifest.views.file, name)


def test_a_tree_that_is_left_out_later_is_warned_of(works: Path, first: Outcome) -> None:
    assert first.code == 0
    out = works / "out"
    again = treebake("textures", works / "work_b", "--shared-atlas", "-o", out, *QUICK, "-q")
    assert again.code == 0
    assert again.lines == [
        f"treebake: warning: {out / 'shared_views'} held the views of a too, whose manifests still point there; "
        "give all trees that share an atlas"
    ]
    assert treebake("textures", works / "work_a", works / "work_b", "--shared-atlas", "-o", out, *QUICK, "-q").code == 0


def test_what_cannot_be_baked_leaves_what_was_shared(works: Path, first: Outcome) -> None:
    assert first.code == 0
    shared = works / "out/shared_views/shared_views.glb"
    before = shared.read_bytes()
    bad = "--set", "slicings.enabled=true", "--set", "slicings.atlas=64", "--set", "views.count=4"
    failed = treebake(
        "textures", works / "work_a", works / "work_b", "--shared-atlas", "-o", works / "out", *QUICK, *bad
    )
    assert failed.code == 2
    assert shared.read_bytes() == before
