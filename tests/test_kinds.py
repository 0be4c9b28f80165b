"""The registry of flows and contacts: each has all functions of its protocol, and one of one file works everywhere."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxvibro as jv
from jaxvibro.contact import force_law, force_spring, kinds, linear, rigid
from jaxvibro.flight import force_flow, linear_flow
from jaxvibro.flight.protocols import Contact, Flow
from jaxvibro.scene.check import SceneError
from jaxvibro.scene.scene import LINEAR_CONTACT, RIGID_CONTACT

from . import toy_contact, toy_flow

EXACT = 1e-12
GRAVITY, DECELERATION, FREQUENCY, AMPLITUDE = 1.0, 6.0, 2.0, 0.3
PERIOD = 2.0 * np.pi / FREQUENCY


def functions_of(protocol):
    """Return {name: signature without self} of the functions of a protocol."""
    members = {name: value for name, value in vars(protocol).items() if inspect.isfunction(value) and name[0] != "_"}
    return {name: inspect.signature(value) for name, value in members.items()}


def parameters(signature):
    """Return [(name, default)] of the parameters other than self."""
    return [(part.name, part.default) for part in signature.parameters.values() if part.name != "self"]


def lacks(module, protocol):
    """Return the names that a module lacks of a protocol, or that take other parameters."""
    wrong = [name for name in protocol.__annotations__ if not hasattr(module, name)]
    for name, signature in functions_of(protocol).items():
        function = getattr(module, name, None)
        if function is None or parameters(inspect.signature(function)) != parameters(signature):
            wrong.append(name)
    return wrong


@pytest.mark.parametrize("flow", [*kinds.FLOWS.values(), toy_flow], ids=lambda flow: flow.__name__)
def test_a_flow_has_all_functions(flow):
    assert lacks(flow, Flow) == [] and isinstance(flow, Flow)


@pytest.mark.parametrize("contact", [*kinds.CONTACTS.values(), toy_contact], ids=lambda contact: contact.__name__)
def test_a_contact_has_all_functions(contact):
    assert lacks(contact, Contact) == [] and isinstance(contact, Contact)


def test_a_missing_function_or_another_parameter_is_noticed(monkeypatch):
    assert len(functions_of(Flow)) > 20 and len(functions_of(Contact)) > 25
    monkeypatch.delattr(toy_flow, "fly")
    monkeypatch.setattr(toy_flow, "reverse_time", lambda coefficients: coefficients)
    assert sorted(lacks(toy_flow, Flow)) == ["fly", "reverse_time"]
    monkeypatch.delattr(toy_contact, "CODE_AFTER_IMPACT")
    assert lacks(toy_contact, Contact) == ["CODE_AFTER_IMPACT"]


def scene_of(walls, force=None):
    damping = 0.1 if force is None else None
    return jv.make_scene(1.0, 2.0, damping, 0.7, walls=walls, force=force)


def test_the_kinds_of_a_scene():
    force = jv.Force("polynomial", {"c1": 1.0, "damping": 0.1})
    spring, law = jv.Wall(1.0, stiffness=9.0, damping=0.2), jv.Wall(-1.0, law=jv.Push("hertz", {"stiffness": 9.0}))
    for walls, user_force, expected in (
        ((None, None), None, (linear_flow, rigid, ())),
        ((-1.0, spring), None, (linear_flow, linear, (rigid, linear))),
        ((None, 1.0), force, (force_flow, rigid, (rigid,))),
        ((-1.0, spring), force, (force_flow, force_spring, (rigid, force_spring))),
        ((law, spring), force, (force_flow, force_law, (force_law, force_spring))),
    ):
        chosen = kinds.kinds_of_scene(scene_of(walls, user_force))
        assert (chosen.flow, chosen.contact, chosen.wall_contacts) == expected
        coeffs = kinds.make_flow_coefficients(scene_of(walls, user_force))
        assert coeffs.flow is chosen.flow and coeffs.contact is chosen.contact and hash(coeffs.kinds) == hash(chosen)


@pytest.fixture
def toys(monkeypatch):
    """Register the flow and the contact of the tests."""
    monkeypatch.setitem(kinds.FLOWS, toy_flow.ConstantForce, toy_flow)
    monkeypatch.setitem(kinds.CONTACTS, (toy_contact.Buffer, None), toy_contact)


def buffer(position):
    return jv.Wall(position, law=toy_contact.Buffer(toy_contact.no_function, {"c": DECELERATION}))


def test_contact_phases_of_two_kinds_and_a_contact_without_an_entry_are_refused(toys, monkeypatch):
    force = jv.Force("polynomial", {"c1": 1.0, "damping": 0.1})
    law = jv.Wall(-1.0, law=jv.Push("hertz", {"stiffness": 9.0}))
    with pytest.raises(SceneError, match="one kind"):
        kinds.kinds_of_scene(scene_of((law, buffer(1.0)), force))
    constant = toy_flow.ConstantForce("polynomial", {"c0": 1.0, "damping": 0.0})
    with pytest.raises(SceneError, match="contact for toy_flow"):
        kinds.kinds_of_scene(scene_of((None, jv.Wall(1.0, stiffness=9.0, damping=0.2)), constant))
    assert (RIGID_CONTACT, None) in kinds.CONTACTS and (LINEAR_CONTACT, toy_flow) not in kinds.CONTACTS


# a flow of one file: compared with Taylor steps
def between_walls(force_class):
    force = force_class("polynomial", {"c0": -0.4, "damping": 0.0})
    return jv.make_scene(2.0, 2.1, None, 0.7, walls=(-1.0, 1.0), force=force)


def assert_close(first, second, tolerance=EXACT):
    for values, others in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_allclose(values, others, rtol=tolerance, atol=tolerance)


def test_a_flow_of_one_file_gives_maps_and_derivatives(toys):
    toy, force = between_walls(toy_flow.ConstantForce), between_walls(jv.Force)
    assert kinds.kinds_of_scene(toy).flow is toy_flow
    states = jv.State(np.array([0.2, -0.5, 0.0, 0.7]), np.array([0.4, 1.3, -0.2, -1.0]))

    def end(scene, x, v):
        final, impacts = jv.strobe(scene, jv.State(x, v), periods=2, slots=8)
        return final.x, final.v, impacts.speed

    assert_close(end(toy, states.x, states.v), end(force, states.x, states.v))
    slopes = [
        jax.jvp(lambda x, scene=scene: end(scene, x, states.v), (states.x,), (np.ones(4),))[1] for scene in (toy, force)
    ]
    assert_close(*slopes, 1e-10)
    assert_close(jv.monodromy(toy, states), jv.monodromy(force, states), 1e-10)


# a contact of one file: compared with the closed form
def bouncing():
    """Return the scene of a mass that falls on a buffer at 0."""
    force = toy_flow.ConstantForce("polynomial", {"c0": -GRAVITY, "damping": 0.0})
    return jv.make_scene(AMPLITUDE, FREQUENCY, None, 0.7, walls=(None, buffer(0.0)), force=force)


def flown(x, v, time, duration):
    """Return (x, v) after a flight that starts at a time."""
    angle, end = FREQUENCY * time, FREQUENCY * (time + duration)
    gain = AMPLITUDE / FREQUENCY
    return (
        x
        + duration * (v - gain * jnp.sin(angle) + 0.5 * GRAVITY * duration)
        + gain / FREQUENCY * (jnp.cos(angle) - jnp.cos(end)),
        v + GRAVITY * duration + gain * (jnp.sin(end) - jnp.sin(angle)),
    )


def flights_in(x, v, time, end):
    """Return the durations of the flights between contacts until a time."""
    durations = []
    while time < end:
        samples = np.linspace(1e-9, end - time, 400)
        beyond = np.flatnonzero(np.asarray(flown(x, v, time, samples)[0]) > 0)
        if not beyond.size:
            return durations
        bracket = samples[beyond[0] - 1] if beyond[0] else 0.0, samples[beyond[0]]
        duration = brentq(lambda s, start=(x, v, time): float(flown(*start, s)[0]), *bracket)
        durations.append(duration)
        x, v = 0.0, -float(flown(x, v, time, duration)[1])
        time = time + duration - 2.0 * v / DECELERATION
    return durations


def bounced(x, v, time, end, durations):
    """Return (x, v) at a time after flights of known approximate durations, differentiable."""
    for duration in durations:
        for _ in range(3):
            position, velocity = flown(x, v, time, duration)
            duration = duration - position / velocity
        speed = flown(x, v, time, duration)[1]
        time, x, v = time + duration, 0.0 * speed, -speed
        inside = end - time
        if inside < 2.0 * speed / DECELERATION:
            return inside * (speed - 0.5 * DECELERATION * inside), speed - DECELERATION * inside
        time = time + 2.0 * speed / DECELERATION
    return flown(x, v, time, end - time)


def by_hand(state, periods=1):
    """Return (x, v) after some periods, and the derivative with respect to the initial (x, v)."""
    x, v, time = float(state.x), float(state.v), float(state.phase) / FREQUENCY
    end = time + periods * PERIOD
    durations = flights_in(x, v, time, end)
    slopes = [
        jax.jvp(lambda x, v: bounced(x, v, time, end, durations), (x, v), one)[1] for one in ((1.0, 0.0), (0.0, 1.0))
    ]
    return np.array(bounced(x, v, time, end, durations)), np.array(slopes).T


STARTS = jv.State(np.array([-0.9, -0.3, -1.4, -0.05]), np.array([0.0, 1.1, 0.3, -1.6]), np.array([0.0, 0.7, 2.0, 4.0]))


@pytest.mark.parametrize("periods", [1, 2])
def test_a_contact_of_one_file_gives_maps_and_derivatives(toys, periods):
    scene = bouncing()
    assert kinds.kinds_of_scene(scene).contact is toy_contact
    starts = [jv.State(STARTS.x[k], STARTS.v[k], STARTS.phase[k]) for k in range(4)]
    expected = [by_hand(start, periods) for start in starts]

    def end(x, v):
        final, _ = jv.strobe(scene, jv.State(x, v, STARTS.phase), periods=periods, slots=8)
        return jnp.stack([final.x, final.v], -1)

    assert_close(end(STARTS.x, STARTS.v), np.array([state for state, _ in expected]))
    unit, zero = np.ones(4), np.zeros(4)
    columns = [jax.jvp(end, (STARTS.x, STARTS.v), one)[1] for one in ((unit, zero), (zero, unit))]
    matrices = np.array([matrix for _, matrix in expected])
    assert_close(np.stack(columns, -1), matrices, 1e-11)
    assert_close(jv.monodromy(scene, STARTS, periods), matrices, 1e-11)


def test_a_contact_of_one_file_has_orbits_and_branches(toys):
    orbit = jv.find_orbit(bouncing(), jv.State(-0.9, 0.0), periods=1, settle=0)
    state, matrix = by_hand(orbit.state)
    np.testing.assert_allclose(state, [orbit.state.x, orbit.state.v], atol=EXACT)
    assert_close(np.sort_complex(np.linalg.eigvals(matrix)), np.sort_complex(orbit.multipliers), 1e-10)
    branch = jv.follow(orbit, "frequency", bounds=(1.9, 2.1))
    multipliers = branch.data["multiplier_real"].values + 1j * branch.data["multiplier_imag"].values
    np.testing.assert_allclose(np.prod(multipliers, axis=-1), 1.0, atol=1e-9)  # nothing loses energy
    assert len(multipliers) > 5
