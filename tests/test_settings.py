"""Settings: one source of defaults, later layers win, and errors that name the file and the key."""

from dataclasses import replace
from pathlib import Path

import pytest

from treebake.errors import SettingsError
from treebake.resources import resource
from treebake.settings import Settings, default_toml, keys, load_settings, parse_assignments


def written(folder: Path, text: str) -> Path:
    path = folder / "tree.toml"
    path.write_text(text)
    return path


def test_default_toml_is_what_the_dataclasses_say() -> None:
    assert resource("configs/default.toml").read_text() == default_toml(), (
        "renew it with: .venv/bin/python -m treebake.settings > configs/default.toml"
    )


def test_default_toml_loads_as_the_defaults() -> None:
    assert load_settings([resource("configs/default.toml")]) == load_settings() == Settings()


@pytest.mark.parametrize("path", sorted(resource("configs").glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_config_loads(path: Path) -> None:
    load_settings([path])


def test_every_setting_says_what_it_means() -> None:
    assert [key.name for key in keys().values() if len(key.help) < 10] == []


def test_later_files_and_overrides_win(tmp_path: Path) -> None:
    first = written(tmp_path, "[cluster]\nbillboards = 3\nseed = 1\n")
    second = tmp_path / "second.toml"
    second.write_text("[cluster]\nseed = 2\n")
    settings = load_settings([first, second], {"cluster": {"iterations": 9}})
    assert (settings.cluster.billboards, settings.cluster.seed, settings.cluster.iterations) == (3, 2, 9)


def test_trunk_budget_is_the_twigs_too_unless_they_have_their_own() -> None:
    both = load_settings(overrides={"trunk": {"triangles": 500}})
    assert (both.trunk.triangles, both.twigs.trunk_triangles) == (500, 500)
    own = load_settings(overrides={"trunk": {"triangles": 500}, "twigs": {"trunk_triangles": 900}})
    assert (own.trunk.triangles, own.twigs.trunk_triangles) == (500, 900)


def test_the_thick_planes_have_defaults_of_their_own(tmp_path: Path) -> None:
    thick, flat = Settings().indirect_cluster, Settings().cluster
    assert (thick.billboards, thick.angle_weight, thick.compactness) == (278, 1.0, 0.5)
    assert thick.billboards < flat.billboards
    assert thick.compactness > flat.compactness
    defaults = {name: keys()[f"indirect_cluster.{name}"].default for name in ("billboards", "compactness")}
    assert defaults == {"billboards": 278, "compactness": 0.5}  # what the help shows
    partly = load_settings([written(tmp_path, "[indirect_cluster]\nbillboards = 107\n")])
    assert partly.indirect_cluster == replace(thick, billboards=107)
    assert partly.cluster == flat
    assert load_settings(overrides={"cluster": {"compactness": 0.2}}).indirect_cluster == thick


def test_tables_within_settings_merge_too(tmp_path: Path) -> None:
    path = written(tmp_path, "[verify.thresholds]\ncoverage_min = 0.9\nflip_ratio = { 512 = 1.2 }\n")
    overrides = parse_assignments(["verify.thresholds.flip_ratio.256=1", "verify.thresholds.coverage_min=0.95"])
    merged = load_settings([path], overrides).verify.thresholds
    assert merged == {"coverage_min": 0.95, "flip_ratio": {"512": 1.2, "256": 1.0}}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[cluster]\nbillbords = 3", r"tree\.toml: .* cluster\.billbords; did you mean cluster\.billboards\?"),
        ("[clusters]\nbillboards = 3", r"tree\.toml: there is no table \[clusters\]; did you mean cluster\?"),
        ("[load]\nbillboards = 3", r"load\.billboards; did you mean cluster\.billboards\?"),
        ("[cluster]\nbillboards = '3'", r"tree\.toml: cluster\.billboards = '3': Expected int, got str"),
        ("[cluster]\nangle_weight = true", r"cluster\.angle_weight = True: Expected float, got bool"),
        ("[split]\nfoliage_materials = [1]", r"split\.foliage_materials = \[1\]: Expected str, got int"),
        ("[cluster]\nangle_weight = inf", r"tree\.toml: cluster\.angle_weight = inf: give a finite number"),
        ("[verify]\nelevations = [0, nan]", r"verify\.elevations = \[0, nan\]: give a finite number"),
        ("[verify.thresholds]\nflip = { 64 = nan }", r"verify\.thresholds = .*: give a finite number"),
        ("billboards = 3", r"there is no table \[billboards\]"),
        ("[cluster", r"tree\.toml is not valid TOML"),
    ],
)
def test_mistake_is_named_with_its_file_and_key(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(SettingsError, match=says) as caught:
        load_settings([written(tmp_path, text)])
    assert "\n" not in str(caught.value)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"nowhere\.toml cannot be read"):
        load_settings([tmp_path / "nowhere.toml"])


def test_assignment_is_toml_or_plain_text() -> None:
    parsed = parse_assignments(["load.up=z", "cluster.billboards=7", "load.textures.Bark=bark 1.png"])
    assert parsed == {"load": {"up": "z", "textures": {"Bark": "bark 1.png"}}, "cluster": {"billboards": 7}}


@pytest.mark.parametrize("text", ["cluster.billboards", "=3", "a b=3"])
def test_what_is_no_assignment_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match="is no setting"):
        parse_assignments([text])
