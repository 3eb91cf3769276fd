"""The work folder: what comes back, what is skipped, what is refused."""

import ast
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from treebake import workspace
from treebake.errors import WorkspaceError
from treebake.files import atomic
from treebake.model import AlphaMode, Material, Mesh, Texture
from treebake.workspace import Result, Workspace


@dataclass(frozen=True)
class Times:
    factor: int = 2  # of the positions


def mesh() -> Mesh:
    texture = Texture("leaf", np.arange(64, dtype=np.uint8).reshape(4, 4, 4))
    return Mesh(
        positions=np.eye(3, dtype=np.float32),
        normals=np.eye(3, dtype=np.float32),
        uvs=np.zeros((3, 2), np.float32),
        faces=np.array([[0, 1, 2]], np.int32),
        face_material=np.zeros(1, np.int32),
        face_node=np.zeros(1, np.int32),
        materials=(
            Material("a", (0.1, 0.2, 1 / 3, 1.0), color_map=texture, alpha_mode=AlphaMode.MASK),
            Material("b", color_map=texture),
        ),
        nodes=("root",),
    )


class Stage:
    """A stage that counts its calls; `__name__` and `__module__` are what the work folder knows it by."""

    __name__ = "scale"

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, value: Mesh, settings: Times) -> Mesh:
        self.calls += 1
        return replace(value, positions=value.positions * np.float32(settings.factor))


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_value_comes_back_as_it_was(tmp_path: Path) -> None:
    Workspace(tmp_path).keep("mesh", mesh())
    back = Workspace(tmp_path).read("mesh", "make").value
    assert isinstance(back, Mesh)
    np.testing.assert_array_equal(back.faces, mesh().faces)
    assert back.faces.dtype == np.int32
    assert back.materials[0].base_color == (0.1, 0.2, 1 / 3, 1.0)
    assert back.materials[0].alpha_mode is AlphaMode.MASK
    assert back.nodes == ("root",)


def test_shared_texture_is_stored_once_and_comes_back_shared(tmp_path: Path) -> None:
    Workspace(tmp_path).keep("mesh", mesh())
    with np.load(tmp_path / "stages/mesh.npz") as file:
        assert sum(file[name].shape == (4, 4, 4) for name in file.files) == 1
    materials = Workspace(tmp_path).read("mesh", "make").value.materials
    assert materials[0].color_map is materials[1].color_map


def test_same_value_gives_same_bytes(tmp_path: Path) -> None:
    Workspace(tmp_path / "a").keep("mesh", mesh())
    Workspace(tmp_path / "b").keep("mesh", mesh())
    assert (tmp_path / "a/stages/mesh.npz").read_bytes() == (tmp_path / "b/stages/mesh.npz").read_bytes()


@pytest.mark.parametrize(
    ("settings", "change", "calls"),
    [(Times(2), 1.0, 1), (Times(3), 1.0, 2), (Times(2), 0.5, 2)],
    ids=["nothing changed", "another setting", "another input"],
)
def test_stage_runs_only_where_something_changed(
    tmp_path: Path, stage: Stage, settings: Times, change: float, calls: int
) -> None:
    first = Workspace(tmp_path).run(stage, Times(2), Result.of(mesh()))
    changed = replace(mesh(), positions=mesh().positions * np.float32(change))
    second = Workspace(tmp_path).run(stage, settings, Result.of(changed))
    assert stage.calls == calls
    assert (first.digest == second.digest) == (calls == 1)
    np.testing.assert_array_equal(second.value.positions, changed.positions * np.float32(settings.factor))


def test_another_version_of_the_code_runs_again(tmp_path: Path, stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    Workspace(tmp_path).run(stage, Times(), Result.of(mesh()))
    monkeypatch.setattr(workspace, "_code", lambda module: f"{module}, edited")
    Workspace(tmp_path).run(stage, Times(), Result.of(mesh()))
    assert stage.calls == 2


def rooms_imported(*rooms: str) -> set[str]:
    """The rooms (first names below `treebake`) that the files of these import."""
    package = Path(workspace.__file__).parent
    files = [file for room in rooms for file in (package / f"{room}.py", *(package / room).rglob("*.py"))]
    nodes = [node for file in files if file.exists() for node in ast.walk(ast.parse(file.read_text()))]
    modules = [str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)]
    return {module.split(".")[1] for module in modules if module.startswith("treebake.")}


def test_all_that_a_stage_builds_on_is_part_of_its_version() -> None:
    known = {name.removesuffix(".py") for name in workspace._GROUND}
    without_effect = {"stages", "errors", "files", "resources"}  # on a result
    assert rooms_imported("stages", *known) - without_effect <= known


def test_a_stage_run_twice_is_kept_under_two_names(tmp_path: Path, stage: Stage) -> None:
    work, value = Workspace(tmp_path), Result.of(mesh())
    for _ in range(2):
        work.run(stage, Times(2), value)
        work.run(stage, Times(3), value, name="other")
    assert stage.calls == 2
    kept = [work.read(name, "make", value).value.positions.max() for name in ("scale", "other")]
    assert kept == [2, 3]


def test_the_name_is_part_of_the_stamp(tmp_path: Path, stage: Stage) -> None:
    work, value = Workspace(tmp_path), Result.of(mesh())
    work.run(stage, Times(), value)
    (tmp_path / "stages/scale.npz").rename(tmp_path / "stages/other.npz")
    work.run(stage, Times(), value, name="other")
    assert stage.calls == 2


def test_force_runs_again(tmp_path: Path, stage: Stage) -> None:
    for _ in range(2):
        Workspace(tmp_path, force=True).run(stage, Times(), Result.of(mesh()))
    assert stage.calls == 2


def test_damaged_result_is_made_again(tmp_path: Path, stage: Stage) -> None:
    Workspace(tmp_path).run(stage, Times(), Result.of(mesh()))
    file = tmp_path / "stages/scale.npz"
    file.write_bytes(file.read_bytes()[:200])
    Workspace(tmp_path).run(stage, Times(), Result.of(mesh()))
    assert stage.calls == 2
    assert Workspace(tmp_path).read("scale", "make").value.triangles == 1


def test_missing_result_names_the_command(tmp_path: Path) -> None:
    with pytest.raises(WorkspaceError, match=r"no result of twigs; .* treebake cluster TREE"):
        Workspace(tmp_path).read("twigs", "treebake cluster TREE")


def test_damaged_result_names_the_command(tmp_path: Path) -> None:
    (tmp_path / "stages").mkdir()
    (tmp_path / "stages/twigs.npz").write_bytes(b"PK")
    with pytest.raises(WorkspaceError, match=r"twigs\.npz is damaged; .* treebake cluster TREE"):
        Workspace(tmp_path).read("twigs", "treebake cluster TREE")


def test_result_of_an_interrupted_run_is_refused(tmp_path: Path, stage: Stage) -> None:
    work = Workspace(tmp_path)
    work.run(stage, Times(), Result.of(mesh()))
    newer = Result.of(replace(mesh(), nodes=("other",)))
    with pytest.raises(WorkspaceError, match="older than what it is made from"):
        work.read("scale", "make", newer)


def test_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")

    def interrupted() -> None:
        with atomic(path) as file:
            file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("file", "old")]


def test_unwritable_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way of a folder")
    with pytest.raises(WorkspaceError, match=r"file/stages/mesh\.npz cannot be written"):
        Workspace(tmp_path / "file").keep("mesh", mesh())
