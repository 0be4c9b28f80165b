"""Derivatives that lean steps carry along are those of a replay and of the product P Q, whichever tier a lane takes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.maps import strobe_derivatives
from tests.status_proof import RIGID
from tests.tiers_proof import lean, usual

LANES = 400


def slopes(scene, start, periods):
    """The derivatives of x and v by every number of scene and state, shape (lanes, 2, numbers)."""
    leaves, tree = jax.tree.flatten((scene, start))

    def end(moved, *leaves):
        there, begun = tree.unflatten([leaf + moved[k] for k, leaf in enumerate(leaves)])
        done = jv.strobe(there, begun, periods)[0]
        return jnp.stack([done.x, done.v])

    axes = [0 if np.ndim(leaf) else None for leaf in leaves]
    return np.asarray(jax.jit(jax.vmap(jax.jacfwd(end), (None, *axes)))(jnp.zeros(len(leaves)), *leaves))


def _bent(slopes):
    """By what a lane's derivatives move with a rounding of the way: slow impacts bend the map as much as they slope."""
    return np.maximum(1.0, abs(slopes).max((1, 2), keepdims=True)) ** 2


@pytest.mark.parametrize("periods", (1, 3))
@pytest.mark.parametrize("kind", [RIGID[k] for k in (1, 4, 5)])
def test_of_random_scenes_they_are_those_of_the_replay(kind, periods, monkeypatch):
    scene, start = usual(np.random.default_rng(3), LANES, kind)
    given_up = np.asarray(lean(scene, start)[1])
    assert 0 < given_up.sum() < LANES / 2  # both tiers are asked
    found = slopes(scene, start, periods)
    monkeypatch.setattr(strobe_derivatives, "_has_fast_derivatives", lambda task, leaves: False)
    strobe_derivatives._differentiable_strobe.cache_clear()
    expected = slopes(scene, start, periods)
    strobe_derivatives._differentiable_strobe.cache_clear()
    assert not np.array_equal(found, expected)
    assert np.array_equal(np.isnan(found), np.isnan(expected))
    assert np.nanmax(abs(found - expected) / _bent(expected)) < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("kind", [RIGID[1], pytest.param(RIGID[4], marks=pytest.mark.long)])
def test_of_random_scenes_they_are_the_product(kind):
    scene, start = usual(np.random.default_rng(4), LANES, kind)
    places = len(jax.tree.leaves(scene))
    found, expected = slopes(scene, start, 1)[..., places : places + 2], np.asarray(jv.monodromy(scene, start))
    sure = np.isfinite(expected).all((1, 2))
    assert sure.mean() > 0.9
    assert (abs(found - expected) / _bent(expected))[sure].max() < 1e-11
