"""Cards that turn into the planes of the next level, from the stage to the file and back."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gltf_validate import assert_valid
from stems import stem
from synthetic import quad
from test_levels import BRANCHES, crowned, finest, published
from test_levels import SMALL as SETTINGS

from treebake.asset import read_asset, write_asset
from treebake.formats.gltf_file import GltfFile
from treebake.geometry import join
from treebake.glb import encode_glb
from treebake.meshes import read_mesh
from treebake.model import BillboardCloud, Clusters, Hierarchy, Material, Mesh, Texture
from treebake.morph import morph_to_next

GREEN = Material("leaf", base_color=(0.1, 0.5, 0.1, 1.0), double_sided=True)
BUMPY = replace(GREEN, normal_map=Texture("bumps", np.full((2, 2, 4), (128, 128, 255, 255), np.uint8)))


def one(normal: object, offset: float) -> Clusters:
    return Clusters(np.zeros(1, np.int32), np.array([normal], np.float64), np.array([offset]))


def card_between(normal: object, offset: float) -> Mesh:
    """A square facing +Z at z = 0 that has a morph into the given plane."""
    planes = Hierarchy((one((0, 0, 1), 0), one(normal, offset)), (np.zeros(1, np.int32),))
    cloud = BillboardCloud(quad(BUMPY, x=(1, 3), y=(-1, 1)), np.zeros(2, np.int32))
    return morph_to_next(cloud, planes, 0).mesh


def test_a_card_turns_about_its_centre_and_moves_along_the_normal() -> None:
    end = card_between((1, 0, 0), -5).morphed(1)  # the plane x = 5
    assert np.allclose(end.positions, [(5, -1, 1), (5, -1, -1), (5, 1, -1), (5, 1, 1)], atol=1e-6)
    assert np.allclose(end.normals, (1, 0, 0))


def test_a_card_never_turns_over() -> None:
    end = card_between((0, 0, -1), 2).morphed(1)  # the plane z = 2, whose front is the other side
    assert np.allclose(end.positions, quad(GREEN, x=(1, 3), y=(-1, 1), z=2).positions, atol=1e-6)
    assert np.allclose(end.normals, (0, 0, 1))


def test_half_way() -> None:
    card = card_between((0, 0, 1), -4)
    half = card.morphed(0.5)
    assert np.allclose(half.positions, card.positions + np.array((0, 0, 2)))
    assert half.morph is None
    assert (card.morphed(0).positions == card.positions).all()


@pytest.mark.parametrize("level", [0, 1])
def test_morphed_cards_lie_in_the_planes_of_the_next_level(tmp_path: Path, level: int) -> None:
    tree = crowned(BRANCHES)
    planes = finest(tree, SETTINGS)[1]
    assert planes is not None
    whole = published(tree, tmp_path)
    clouds = [morph_to_next(whole.cloud, planes, 0), *(each.cloud for each in whole.levels)]
    cloud, coarser = clouds[level], planes.levels[level + 1]
    end = cloud.mesh.morphed(1)
    parent = planes.parents[level][cloud.face_cluster]
    normals, offsets = coarser.normals[parent], coarser.offsets[parent]
    corners = end.positions[end.faces].astype(np.float64)
    assert np.allclose(np.einsum("fki,fi->fk", corners, normals), -offsets[:, None], atol=1e-5)
    side = np.sign((end.normals[end.faces[:, 0]] * normals).sum(axis=1))[:, None]
    assert np.allclose(end.normals[end.faces], (side * normals)[:, None], atol=1e-6)
    assert np.allclose(end.face_areas, cloud.mesh.face_areas, rtol=1e-4)
    before, after = (mesh.positions.reshape(-1, 4, 3).mean(axis=1) for mesh in (cloud.mesh, end))
    assert np.abs(after - before).max() < 2  # a card stays where its leaves are
    assert clouds[-1].mesh.morph is None


def test_a_morph_goes_with_the_vertices() -> None:
    card = card_between((1, 0, 0), -5)
    assert card.morph is not None
    half = card.select(np.array([False, True]))
    assert half.morph is not None
    assert (half.morph.positions == card.morph.positions[[0, 2, 3]]).all()
    both = join(stem(), card)
    assert both.morph is not None
    assert (both.morphed(1).positions == np.concatenate([stem().positions, card.morph.positions])).all()
    assert join(stem(), stem()).morph is None


def test_written_and_read(tmp_path: Path) -> None:
    card = card_between((0.6, 0, 0.8), -2)
    path = tmp_path / "card.glb"
    path.write_bytes(encode_glb([("cloud", card), ("trunk", stem())]))
    assert_valid(path)
    read = read_mesh(path)
    assert card.morph is not None
    assert read.morph is not None
    cloud = read.select(read.face_node == read.nodes.index("cloud"))
    assert cloud.morph is not None
    assert np.allclose(cloud.morph.positions, card.morph.positions, atol=1e-6)
    assert np.allclose(cloud.morph.normals, card.morph.normals, atol=1e-6)
    trunk = read.select(read.face_node == read.nodes.index("trunk"))
    assert (trunk.morphed(1).positions == trunk.positions).all()
    file = GltfFile(path)
    meshes = {mesh["name"]: mesh for mesh in file.json["meshes"]}
    assert meshes["cloud"]["weights"] == [0]
    assert meshes["cloud"]["extras"] == {"targetNames": ["parent"]}
    assert not {"weights", "extras"} & meshes["trunk"].keys()
    (primitive,) = meshes["cloud"]["primitives"]
    tangents = file.accessor(primitive["attributes"]["TANGENT"])[:, :3] + file.accessor(
        primitive["targets"][0]["TANGENT"]
    )
    assert np.allclose(tangents, (0.8, 0, -0.6), atol=1e-6)  # u still runs to the card's right


@pytest.mark.parametrize("change", ["name", "sparse", "quantised"])
def test_the_targets_of_others_are_left_out(tmp_path: Path, change: str) -> None:
    data = encode_glb([("cloud", card_between((1, 0, 0), -5))])
    size = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + size])
    target = document["accessors"][document["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]]
    if change == "name":
        document["meshes"][0]["extras"]["targetNames"] = ["wind"]
    elif change == "sparse":
        target["sparse"] = {"count": 1}
    else:
        target["componentType"] = 5122
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = data[:8] + (len(data) - size + len(text)).to_bytes(4, "little") + len(text).to_bytes(4, "little")
    (tmp_path / "card.glb").write_bytes(head + data[16:20] + text + data[20 + size :])
    assert read_mesh(tmp_path / "card.glb").morph is None


def test_levels_are_published_with_their_morphs(tmp_path: Path) -> None:
    tree = crowned(BRANCHES)
    planes = finest(tree, SETTINGS)[1]
    assert planes is not None
    whole = published(tree, tmp_path)
    write_asset(replace(whole, cloud=morph_to_next(whole.cloud, planes, 0)), tmp_path / "oak")
    paths = read_asset(tmp_path / "oak").level_paths
    assert [read_mesh(path).morph is not None for path in paths] == [True, True, False]
    assert_valid(*paths)
