"""Tracing: each public function can be traced, or refuses tracers at once in one line."""

import inspect
import re

import jax
import jax.numpy as jnp
import pytest

import jaxvibro as jv
from tests.properties.test_studies import STUDIES
from tests.scene_files import call_command, refusal

TRACED = {
    "make_scene": lambda x: jv.make_scene(x, 2.1, 0.05, 0.7, (-1.0, 1.0)).amplitude,
    "scene_from_physical": lambda x: jv.scene_from_physical(1.0, 0.1, 1.0, x, 2.1, 0.7, (-1.0, 1.0)).amplitude,
    "soften": lambda x: jv.soften(SCENE, 100.0 + x).right.stiffness,
    "effective_restitution": lambda x: jv.effective_restitution(100.0, x),
    "contact_damping": lambda x: jv.contact_damping(100.0 + x, 0.7),
    "strobe": lambda x: jv.strobe(SCENE, jv.State(x, 0.0), slots=4)[0].x,
    "monodromy": lambda x: jv.monodromy(SCENE, jv.State(x, 0.0))[0, 0],
    "sample": lambda x: jv.sample(SCENE, jv.State(x, 0.0), jnp.array([0.5, 1.0]))[0].x[1],
    "solve_orbits": lambda x: jv.solve_orbits(SCENE.replace(amplitude=2.0 + x), jv.State(0.0, 0.0), ("",)).state.x,
    "return_map": lambda x: jv.return_map(SCENE, "right", x, -1.0).velocity,
}
FILES = ("load_scene", "paper")  # take no numbers, give none back that a transformation could use
SCENE = jv.make_scene(2.0, 2.1, 0.05, 0.7, (-1.0, 1.0))
PUBLIC = [name for name in jv.__all__ if inspect.isfunction(getattr(jv, name))]
HOST = [name for name in PUBLIC if name not in TRACED and name not in FILES]


def test_every_public_function_is_known_here():
    assert not set(TRACED) - set(PUBLIC) and not set(FILES) - set(PUBLIC)
    assert {"find_orbit", "follow", "simulate", "locus", "switch", "extend", "explore", "sweep", "basins"} <= set(HOST)
    assert all(inspect.isclass(getattr(jv, name)) for name in set(jv.__all__) - set(PUBLIC) - {"plot", "__version__"})


@pytest.mark.parametrize("name", TRACED)
def test_what_is_traced_can_be(name):
    for transformed in (jax.jit(TRACED[name]), jax.vmap(TRACED[name])):
        shapes = jax.eval_shape(transformed, jnp.full(3, 0.3) if transformed is not jax.jit else 0.3)
        assert shapes.dtype == jnp.float64


def called(function, x):
    """Call a function with as many arguments as it needs, one of them traced, in a scene or alone."""
    names = inspect.signature(function).parameters
    given = {name: SCENE.replace(amplitude=x) if name == "scene" else x for name in names}
    by_name = {name: given.pop(name) for name, one in names.items() if one.kind is one.KEYWORD_ONLY}
    return function(*given.values(), **by_name)


@pytest.mark.parametrize("name", HOST)
def test_what_runs_on_the_host_says_so_at_once(name):
    function = getattr(jv, name)
    text = f"{name}: runs on the host and cannot be traced by jit, vmap or grad: call it outside; inside, "
    traced, plain = (lambda x: called(function, x)), (lambda x: (called(function, 2.0), x)[1])
    for one in (traced, plain):
        for transformed in (jax.jit(one), jax.grad(one), lambda x, one=one: jax.vmap(one)(jnp.full(2, x))):
            assert refusal(transformed, 2.0).startswith(text)
    assert inspect.signature(function).parameters and function.__doc__ and function.__name__ == name


@pytest.mark.parametrize("name", jv.plot.__all__)
def test_a_picture_says_what_it_is_of(name):
    function, orbit = getattr(jv.plot, name), jv.State(0.0, 0.0)
    count = sum(one.default is one.empty for one in inspect.signature(function).parameters.values())
    for wrong in (orbit, 3.0, None, "name", SCENE, [orbit], jv.Impacts(*[0] * 7)):
        assert refusal(function, *[wrong] * count).startswith(f"plot.{name}: must be given a")


def test_a_picture_names_the_function_that_draws_a_record():
    orbit = jv.find_orbit(SCENE.replace(amplitude=0.5), jv.State(0.0, 0.0))
    hint = "plot.branch: must be given a Branch (an Orbit is drawn by plot.orbit); got Orbit(label='P100'"
    assert refusal(jv.plot.branch, orbit).startswith(hint)
    path = jv.simulate(SCENE, jv.State(0.0, 0.0))
    assert refusal(jv.plot.diagram, path).endswith("must be given a Dataset of sweep; got 'Dataset'")
    diagram = jv.Diagram("amplitude", (0.0, 1.0), SCENE, (), (), True, "", {})
    assert "a Diagram is drawn by plot.branch, one call for each" in refusal(jv.plot.diagram, diagram)


def test_the_help_names_all_tables_and_figures(capsys):
    for words in ([], ["run"], ["paper"], ["init"]):
        assert call_command(*words, "--help") == 0
        text = " ".join(capsys.readouterr().out.split())
        assert "between rigid walls" not in text
        if words == ["run"]:
            assert "Walls are rigid or soft" in text
            assert [name for name in STUDIES if name != "scene" and f"[{name}]" not in text] == []
        if words == ["paper"]:
            assert "figures 2 to 12" in text and "fig2 to fig12, walls, formulas" in text
    known = re.findall(r"[a-z]+\d*", refusal(jv.paper, ["unknown"]).split("(")[1].split(")")[0])
    assert set(known) == {*(f"fig{k}" for k in range(2, 13)), "walls", "formulas"} and "soft" in jv.__doc__
