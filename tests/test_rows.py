"""Rows of points in tuples of arrays, against lists of rows; what is known of points, asked of the new ones alone."""

from typing import NamedTuple

import numpy as np
import pytest

import jaxvibro as jv
from continuation import continuation_loop, point_rows
from continuation.arclength import Point
from continuation.continuation_loop import EventDetector
from jaxvibro.branches.branch import scene_at_value

rng = np.random.default_rng(11)


class Seen(NamedTuple):
    size: np.ndarray
    turned: np.ndarray


class Counting(EventDetector):
    def __init__(self):
        self.asked = 0

    def diagnose(self, zs):
        self.asked += len(zs)
        return Seen((zs * zs).sum(axis=1), zs[:, ::-1, None] * np.arange(2.0))


def listed(points):
    return [tuple(np.asarray(leaf[k]).tolist() for leaf in points) for k in range(len(points[0]))]


def drawn(count):
    z, tangent = rng.normal(size=(2, count, 3))
    step, residual, determinant = rng.normal(size=(3, count))
    met, kept = rng.random((2, count)) < 0.5
    return Point(z, tangent, step, residual, determinant, met, kept)


def test_rows_are_those_of_lists():
    points, one = drawn(5), point_rows.row_at(drawn(1), 0)
    plain = listed(points)
    assert (
        listed(point_rows.first_rows(points, 3)) == plain[:3] and listed(point_rows.reverse_rows(points)) == plain[::-1]
    )
    assert tuple(np.asarray(leaf).tolist() for leaf in point_rows.row_at(points, -2)) == plain[-2]
    assert (
        listed(point_rows.join_rows([points, points, point_rows.first_rows(points, 2)]))
        == plain + plain[1:] + plain[1:2]
    )
    for place in range(1, 6):
        found = listed(point_rows.insert_row(points, place, one))
        expected = [*plain[:place], tuple(np.asarray(leaf).tolist() for leaf in one), *plain[place:]]
        if place < 5:  # what is left of the step to the row after it
            after = list(expected[place + 1])
            after[2] -= float(one.step)
            expected[place + 1] = tuple(after)
        assert found == expected
    assert listed(points) == plain
    assert point_rows.row_at(None, 0) is None and point_rows.join_rows([None, None]) is None


@pytest.mark.parametrize("kept, new", [([0, 1, 2, 3], 0), ([0, 2, 3], 1), ([], 3), ([0, 1], 0), ([3], 2)])
def test_what_is_known_is_asked_of_new_points_alone(kept, new):
    watch, before = Counting(), rng.normal(size=(4, 3))
    view = watch.diagnose(before)
    held = [leaf.copy() for leaf in view]
    zs = rng.permutation(np.concatenate([before[kept], rng.normal(size=(new, 3))]), axis=0)
    watch.asked = 0
    found = continuation_loop._diagnose_new_points(watch, zs, before, view)
    assert watch.asked == new
    for one, other in zip(found, watch.diagnose(zs), strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(view, held, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_scene_on_a_branch_is_the_one_with_another_value():
    rigid = jv.make_scene(
        2.0, 2.1, 0.05, 0.7, (jv.Wall(-1.0, motion=jv.Motion(0.1, 0.5, 2)), jv.Wall(1.2, restitution=0.6))
    )
    soft = jv.make_scene(2.0, 1.7, 0.1, 0.7, (jv.Wall(-1.0, stiffness=300.0, damping=2.0), None))
    for scene in (rigid, soft):
        for name in scene.names:
            value = 1.07 * float(scene.parameter(name)) if name != "restitution" else 0.4
            found, expected = scene_at_value(scene, name, value), scene.replace(**{name: value})
            assert found.names == expected.names
            for one in expected.names:
                assert found.parameter(one).dtype == expected.parameter(one).dtype
                assert float(found.parameter(one)) == float(expected.parameter(one)), (name, one)
            assert type(found.amplitude) is type(expected.amplitude)
            assert type(found.parameter(name)) is type(expected.parameter(name))
