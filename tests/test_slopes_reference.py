"""The reference derivatives by second routes: the certified record, saltation matrices, a step half as long."""

import numpy as np
import pytest
from flint import arb, ctx

from tests.reference import draws, orbit, search, slopes


@pytest.fixture(scope="module")
def fair():
    """(draw, record) of some seeds that are fair tests."""
    found = []
    for drawn in map(draws.draw, range(40)):
        try:
            found.append((drawn, orbit.strobe(*drawn)))
        except search.Discard:
            continue
    return found


def test_the_replay_is_the_record(fair):
    for drawn, record in fair:
        with ctx.workprec(slopes.PRECISION):
            again = slopes.replay(slopes.with_numbers(drawn, [arb(each) for each in slopes.numbers(drawn)]), record)
            known = [record.x, record.v, *record.times, *record.speeds]
            assert max(abs(a - b) for a, b in zip(again, known, strict=True)) < 1e-29 * record.scale


def test_by_the_state_it_is_the_product_of_saltation_matrices(fair):
    for drawn, record in fair:
        assert np.abs(slopes.jacobian(drawn, record)[:2, :2] - record.jacobian).max() < 1e-14 * record.norm


def test_half_the_step_changes_nothing(fair):
    for drawn, record in fair[:8]:
        direction = np.ones(len(slopes.names(drawn[0])))
        for order in (1, 2, 3):
            whole, half = (slopes.derivative(drawn, record, direction, order, step=slopes.STEP / k)[:2] for k in (1, 2))
            assert all(abs(a - b) < 1e-40 * (1 + abs(a)) for a, b in zip(whole, half, strict=True))
