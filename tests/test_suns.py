"""The lights of the verifier: suns from everywhere, and those of a day."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from treebake.gl.light import DAYLIGHT, Light
from treebake.verify.suns import day, unseen_suns


def elevation(light: Light) -> float:
    return float(np.degrees(np.arcsin(light.sun_direction[1])))


@given(st.integers(1, 64))
def test_suns_are_apart_above_the_horizon_and_none_is_the_one_that_is_fitted_with(count: int) -> None:
    ways = np.array([light.sun_direction for light in unseen_suns(count)])
    assert np.allclose(np.linalg.norm(ways, axis=1), 1)
    assert (ways[:, 1] > 0.25).all()
    angles = np.degrees(np.arccos(np.clip(ways @ np.vstack([ways, DAYLIGHT.sun_direction]).T, -1, 1)))
    angles[np.arange(count), np.arange(count)] = 180
    assert angles.min() > 2


def test_eight_suns_come_from_all_sides() -> None:
    ways = np.array([light.sun_direction for light in unseen_suns(8)])
    around = np.sort(np.degrees(np.arctan2(ways[:, 0], ways[:, 2])))
    assert np.diff(around, append=around[0] + 360).max() < 90


def test_the_sun_rises_at_plus_x_stands_highest_at_plus_z_and_sets_at_minus_x() -> None:
    hours = day(24)
    up = [hour for hour, light in enumerate(hours) if any(light.sun)]
    assert up == list(range(5, 20))
    assert hours[up[0]].sun_direction[0] > 0.7
    assert hours[up[-1]].sun_direction[0] < -0.7
    assert max(range(24), key=lambda hour: elevation(hours[hour]) if hour in up else -90) == 12
    assert elevation(hours[12]) == pytest.approx(90 - 45 + 23.44, abs=0.01)
    assert hours[12].sun_direction[2] > 0.3
    assert all(np.isclose(np.linalg.norm(light.sun_direction), 1) for light in hours)


def test_a_low_sun_is_red_and_at_night_only_a_dark_sky_is_left() -> None:
    hours = day(24)
    red, _, blue = hours[5].sun
    assert red > 3 * blue
    assert np.ptp(hours[12].sun) < 0.5
    assert hours[0].sun == (0.0, 0.0, 0.0)
    assert 0 < max(hours[0].sky) < 0.05
    assert sum(hours[0].sky) < sum(hours[4].sky) < sum(hours[12].sky)
