"""Small cases of corrected errors that random scenes have found."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv

FIT = 'record = "a.csv"\nfree = {damping = 0.1}\nsigma = 0.1\n'


@pytest.fixture(scope="module")
def scene():
    return jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))


def test_the_clearance_at_a_turning_point_that_newton_steps_from_an_end_of_the_step_miss():
    """The expected value is that of ball arithmetic."""
    walls = (jv.Wall(-1.5853939056396484, 0.8380146026611328), jv.Wall(1.0919685363769531, 0.6887922286987305))
    terms = [(6.293706893920898, 3, 4.095937728881836), (1.4612503051757812, 0, 0.0), (0.6293706893920898, 1, 0.5)]
    scene = jv.make_scene(-7.673480987548828, 0.9353179931640625, 1.0120649337768555, 0.7, walls, drive=terms)
    state = jv.State(0.5118030388712214, 3.5685386657714844, -1.4406213760375977)
    least = jv.strobe(scene, state, slots=8, clearance=True)[1].least_clearance
    assert float(least) == pytest.approx(0.11220151617877824, abs=1e-12)


def test_second_derivatives_by_numbers_of_a_batch(scene):
    batch, x, step = scene.replace(amplitude=np.array([1.9, 2.0, 2.1])), jnp.array([0.9, 0.5, -0.3]), 1e-5

    def end(change):
        return jv.strobe(batch.replace(amplitude=batch.amplitude + change), jv.State(x, 1.1))[0].x

    first = jax.jit(jax.jacfwd(end))
    difference = (first(step) - first(-step)) / (2.0 * step)
    assert np.allclose(jax.jacfwd(first)(0.0), difference, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("columns", [2, 4])
def test_basins_of_a_grid_of_few_columns(scene, columns):
    data = jv.basins(scene, np.linspace(-0.9, 0.9, columns), np.linspace(-2.0, 2.0, 6))
    assert data["label"].sizes == {"x": columns, "v": 6} and (data["label"] >= -1).all()


def test_orbits_that_stick_without_chatter_are_explored():
    wall = jv.Wall(-0.09401321411132812, 0.0)
    scene = jv.make_scene(1.9713258743286133, 3.762782096862793, 0.09668350219726562, walls=(None, wall))
    diagram = jv.explore(scene, "amplitude", (1.6, 2.4), 4)
    assert len(diagram.branches) > 0


@pytest.mark.parametrize("line", ["sigma_v = nan", 'flawed = "text"'])
def test_invalid_values_of_a_fit_are_refused_when_the_file_is_read(tmp_path, line):
    scene = "[scene]\namplitude = 2.0\nfrequency = 2.1\ndamping = 0.05\nrestitution = 0.7\nright = {position = 1.0}\n"
    (tmp_path / "scene.toml").write_text(f"{scene}[fit]\n{FIT}{line}\n")
    with pytest.raises((jv.SceneError, jv.ArgumentError), match=r"fit\." + line.split(" ")[0]):
        jv.run(tmp_path / "scene.toml", tmp_path / "out")


def test_the_matrix_of_a_start_beyond_a_wall_is_nan():
    force = jv.Force("duffing", {"cubic": -0.17, "damping": 0.0}, 1e-10)
    scene = jv.make_scene(0.0, 1.0, walls=(-0.57, 0.57), force=force, restitution=0.06)
    assert np.isnan(jv.monodromy(scene, jv.State(-3.0, -0.28))).all()
