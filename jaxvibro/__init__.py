"""Vibro-impact oscillators with rigid and soft walls: exact flight, certified impacts, studies built on them."""

import sys
from importlib import import_module
from types import ModuleType

__version__ = "0.1.0"

# Where each public name lives. A name is loaded when it is first asked for: `jaxvibro --help` never imports jax.
_HOMES = {
    "Scene": "scene",
    "Wall": "scene",
    "Motion": "scene",
    "make_scene": "scene",
    "SceneError": "check",
    "scene_from_physical": "physical",
    "soften": "soften",
    "effective_restitution": "rebound",
    "contact_damping": "rebound",
    "load_scene": "scenefile",
    "save_scene": "scenefile",
    "load_data": "sealed",
    "State": "state",
    "Impacts": "state",
    "strobe": "strobe",
    "monodromy": "monodromy",
    "simulate": "simulate",
    "return_map": "section",
    "Return": "section",
    "sections": "visits",
    "find_orbit": "find",
    "find_orbits": "orbits",
    "Orbit": "orbit",
    "OrbitError": "orbit",
    "follow": "follow",
    "switch": "switch",
    "extend": "switch",
    "Branch": "branch",
    "load_branch": "branchfile",
    "peaks": "peaks",
    "peak": "peaks",
    "sensitivity": "sensitivity",
    "locus": "locus",
    "Locus": "locus",
    "family": "family",
    "explore": "explore",
    "diagrams": "diagrams",
    "Diagram": "diagram",
    "load_diagram": "diagram",
    "sweep": "sweep",
    "find_attractors": "attractors",
    "spectrum": "spectrum",
    "basins": "basins",
    "manifold": "manifold",
    "run": "run",
    "paper": "paper",
}

__all__ = ["__version__", "plot", *_HOMES]


def __getattr__(name):
    if name == "plot":
        return import_module(".plot", __name__)
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    setattr(sys.modules[__name__], name, value)
    return value


def __dir__():
    return sorted(__all__)


class _Package(ModuleType):
    """Keeps `jaxvibro.strobe` the function: importing the file strobe.py would put the file in its place."""

    def __setattr__(self, name, value):
        if _HOMES.get(name) == name and isinstance(value, ModuleType):
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
