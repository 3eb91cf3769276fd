"""The bits of a placement: what goes in comes out again, as exactly as the bits can hold it."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from treebake.model import Doubles
from treebake.placements import SHAPES, Placements, pack, unpack

STEP = 1 / 65535
seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=20, deadline=None)


def placements(seed: int, count: int = 50) -> Placements:
    """Anything that the bits can hold."""
    random = np.random.default_rng(seed)
    return Placements(
        positions=random.uniform(0, 1, (count, 3)),
        rotations=Rotation.random(count, random).as_matrix(),
        scales=np.exp2(random.uniform(-15, 0, count)),
        narrowings=np.exp2(random.uniform(-7, 0, count)),
        shape=random.integers(0, SHAPES, count).astype(np.int32),
        mirrored=random.random(count) < 0.5,
    )


def one(**values: object) -> Placements:
    """Upright leaves of full size in a corner, but for what is given."""
    count = max((len(np.asarray(value)) for value in values.values()), default=1)
    plain = Placements(
        positions=np.zeros((count, 3)),
        rotations=np.tile(np.eye(3), (count, 1, 1)),
        scales=np.ones(count),
        narrowings=np.ones(count),
        shape=np.zeros(count, np.int32),
        mirrored=np.zeros(count, bool),
    )
    return replace(plain, **{name: np.asarray(value) for name, value in values.items()})


def apart(one: Doubles, other: Doubles) -> Doubles:
    """The angles in degrees between rotations (N, 3, 3)."""
    return np.degrees(Rotation.from_matrix(one @ np.swapaxes(other, 1, 2)).magnitude())


@few
@given(seeds)
def test_positions_are_off_by_half_a_step(seed: int) -> None:
    placed = placements(seed)
    assert np.abs(unpack(pack(placed)).positions - placed.positions).max() <= STEP / 2 * (1 + 1e-9)


def test_the_ends_of_the_box_are_exact() -> None:
    corners = np.array([(0.0, 1.0, 0.0), (1.0, 0.0, 1.0)])
    np.testing.assert_array_equal(unpack(pack(one(positions=corners))).positions, corners)


@few
@given(seeds)
def test_rotations_are_off_by_less_than_the_twenty_fifth_of_a_degree(seed: int) -> None:
    placed = placements(seed)
    assert apart(unpack(pack(placed)).rotations, placed.rotations).max() < 0.04


@pytest.mark.parametrize("largest", range(4))
@few
@given(seeds)
def test_any_part_of_the_quaternion_may_be_the_largest(largest: int, seed: int) -> None:
    quaternion = np.random.default_rng(seed).uniform(-1, 1, (50, 4))
    quaternion[:, largest] = np.sign(quaternion[:, largest]) * np.random.default_rng(seed).uniform(1, 3, 50)
    turned = Rotation.from_quat(quaternion).as_matrix()
    words = pack(one(rotations=turned))
    assert (words[:, 3] >> 13 & 3 == largest).all()
    assert apart(unpack(words).rotations, turned).max() < 0.04


HALF_TURNS = np.array([np.diag(signs) for signs in ((1.0, -1, -1), (-1.0, 1, -1), (-1.0, -1, 1))])
EQUAL_PARTS = Rotation.from_quat([(1, 1, 1, 1), (-1, 1, 1, 1), (1, 1, -1, -1), (1, 1, 0, 0), (0, -1, 0, 1)]).as_matrix()


@pytest.mark.parametrize("turned", [np.eye(3)[None], HALF_TURNS, EQUAL_PARTS], ids=["none", "half turns", "ties"])
def test_degenerate_rotations(turned: Doubles) -> None:
    found = unpack(pack(one(rotations=turned))).rotations
    assert apart(found, turned).max() < 0.04
    np.testing.assert_allclose(found @ np.swapaxes(found, 1, 2), np.tile(np.eye(3), (len(turned), 1, 1)), atol=1e-9)
    assert (np.linalg.det(found) > 0).all()


@few
@given(seeds)
def test_scales_and_narrowings_are_off_by_half_a_step(seed: int) -> None:
    placed = placements(seed, 500)
    found = unpack(pack(placed))
    assert np.abs(found.scales / placed.scales - 1).max() < 1.3e-4
    assert np.abs(found.narrowings / placed.narrowings - 1).max() < 0.065


def test_powers_of_two_are_exact() -> None:
    scales, narrowings = np.exp2(-np.arange(16.0)), np.exp2(-np.arange(8.0))
    np.testing.assert_array_equal(unpack(pack(one(scales=scales))).scales, scales)
    np.testing.assert_array_equal(unpack(pack(one(narrowings=narrowings))).narrowings, narrowings)


def test_scales_just_below_a_power_of_two_carry_into_the_exponent() -> None:
    scales = np.exp2(-np.arange(15.0)) * (1 - 1e-6)
    np.testing.assert_array_equal(unpack(pack(one(scales=scales))).scales, np.exp2(-np.arange(15.0)))


def test_larger_leaves_have_larger_bits() -> None:
    scales = np.exp2(np.linspace(-15, 0, 1000))
    assert (np.diff(unpack(pack(one(scales=scales))).scales) >= 0).all()


@pytest.mark.parametrize("mirrored", [False, True])
def test_every_shape_and_its_mirror_image_is_told_apart(mirrored: bool) -> None:
    shape = np.arange(SHAPES, dtype=np.int32)
    found = unpack(pack(one(shape=shape, mirrored=np.full(SHAPES, mirrored))))
    np.testing.assert_array_equal(found.shape, shape)
    assert (found.mirrored == mirrored).all()


@pytest.mark.parametrize("name", [field.name for field in fields(Placements)])
@few
@given(seeds)
def test_no_field_touches_another(name: str, seed: int) -> None:
    placed, other = placements(seed), placements(seed + 1)
    before = unpack(pack(placed))
    after = unpack(pack(replace(placed, **{name: getattr(other, name)})))
    for field in fields(Placements):
        expected = unpack(pack(other)) if field.name == name else before
        np.testing.assert_array_equal(getattr(after, field.name), getattr(expected, field.name))


@few
@given(seeds)
def test_the_two_top_bits_are_zero(seed: int) -> None:
    assert (pack(placements(seed))[:, 3] >> 30 == 0).all()


def test_every_other_bit_is_used() -> None:
    words = pack(placements(1, 2000))
    assert np.bitwise_or.reduce(words).tolist() == [2**32 - 1, 2**32 - 1, 2**32 - 1, 2**30 - 1]
    assert np.bitwise_and.reduce(words).tolist() == [0, 0, 0, 0]


@few
@given(seeds)
def test_what_is_unpacked_packs_to_the_same_bits(seed: int) -> None:
    once = unpack(pack(placements(seed)))
    again = unpack(pack(once))
    for name in ("positions", "scales", "narrowings", "shape", "mirrored"):
        np.testing.assert_array_equal(getattr(again, name), getattr(once, name))


def test_values_out_of_range_are_clipped() -> None:
    outside = one(positions=[(-0.5, 1.5, 2.0)], scales=[3.0], narrowings=[1.01])
    found = unpack(pack(outside))
    np.testing.assert_array_equal(found.positions, [(0, 1, 1)])
    assert (found.scales, found.narrowings) == (1, 1)
    small = unpack(pack(one(scales=[0.0, 1e-9], narrowings=[0.0, 1e-9])))
    np.testing.assert_array_equal(small.scales, np.exp2([-15.0, -15]))
    np.testing.assert_array_equal(small.narrowings, np.exp2([-7.0, -7]))


def test_no_leaf_packs_to_no_word() -> None:
    none = placements(1, 0)
    words = pack(none)
    assert words.shape == (0, 4)
    assert words.dtype == np.uint32


def test_inputs_stay_as_they_were() -> None:
    placed = placements(3)
    for field in fields(Placements):
        getattr(placed, field.name).flags.writeable = False
    pack(placed)
