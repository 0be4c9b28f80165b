"""List the public names by subject and write the pages of the API reference, which autodoc fills with docstrings."""

import dataclasses
import enum
import inspect
from functools import cached_property
from importlib import import_module

import continuation
import jaxvibro as jv

# Subject of each page, by the folder that defines its names.
SUBJECTS = {
    "scene": "Scenes: oscillator, drive, walls, forces",
    "maps": "Trajectories, stroboscopic and return maps",
    "orbits": "Periodic orbits",
    "attractors": "Attractors, Lyapunov exponents, basins of attraction, manifolds",
    "surveys": "Parameter maps, basin fractions, minimal fatal shock",
    "stores": "Stores and execution engines",
    "branches": "Branches and bifurcation diagrams",
    "loci": "Two-parameter bifurcation curves",
    "design": "Design, sensitivities and fits",
    "plot": "Plots: jaxvibro.plot",
    "output": "Data files and physical units",
    "studies": "Scene files and the analyses in them",
    "explorer": "Explorer",
    "reproduction": "Reproduction of the paper",
    "continuation": "Numerical continuation: the package continuation",
}

# Records that calls return and that users do not import.
RECORDS = {
    "scene": ("scene.state.Status", "scene.state.Contact"),
    "attractors": ("attractors.find.Attractor",),
    "branches": (
        *("branches.branch.Special", "branches.branch.Segment", "branches.normal_form.NormalForm"),
        *("branches.user_monitors.MonitoredPoint", "problem.curve_ends.End"),
        *("branches.branch_curves.Curves", "branches.branch_curves.Piece", "branches.branch_curves.Marks"),
    ),
    "loci": ("loci.locus.Codim2",),
    "studies": ("studies.run.Done", "studies.warm.Warmed"),
    "explorer": ("explorer.view.View",),
    "reproduction": ("reproduction.run.Report", "reproduction.claim.Claim"),
}

# Names that the examples in docstrings use without defining them.
EXAMPLES = """\
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import continuation as co
import jaxvibro as jv

jax.config.update("jax_enable_x64", True)

scene = jv.make_scene(amplitude=2.0, frequency=2.1, damping=0.05, restitution=0.7, walls=(-1.0, 1.0))
state = jv.State(x=0.9, v=-1.1)
orbit = jv.find_orbit(scene, state)
branch = jv.follow(orbit, "amplitude", bounds=(0.0, 6.0))
"""

INDEX = """\
API reference
=============

The pages list every public name with its docstring, by subject. :doc:`../docs/api` lists all public names on one page.

The examples in the docstrings run as tests. They use the following names without defining them:

.. code-block:: python

{examples}

.. toctree::
   :maxdepth: 2

{pages}
"""


def names():
    """Return the public names of each page: {page: [dotted name]}."""
    listed = {page: [] for page in SUBJECTS}
    for name, home in jv._HOMES.items():
        listed[home.split(".")[0]].append(f"jaxvibro.{name}")
    listed["plot"] = [f"jaxvibro.plot.{name}" for name in jv.plot.__all__]
    listed["continuation"] = [f"continuation.{name}" for name in continuation.__all__]
    listed["continuation"] += [f"continuation.shooting.{name}" for name in ("periodic_orbits", "settled")]
    return listed


def records():
    """Return the records of each page: {page: [dotted name]}."""
    return {page: [f"jaxvibro.{home}" for home in RECORDS.get(page, ())] for page in SUBJECTS}


def load(dotted):
    """Return the object with a dotted name, of a module or of a class in it."""
    module, *attributes = dotted.split(".")
    value = import_module(module)
    for name in attributes:
        module = f"{module}.{name}"
        value = import_module(module) if not hasattr(value, name) else getattr(value, name)
    return value


def own_classes(value):
    """Return a class and its base classes in the two packages, the most general first."""
    return [base for base in reversed(value.__mro__) if base.__module__.split(".")[0] in ("jaxvibro", "continuation")]


def fields(value):
    """Return the names of the public fields of a class."""
    named = [field.name for field in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else ()
    return [name for name in named or getattr(value, "_fields", ()) if not name.startswith("_")]


def members(value):
    """Return the names of the public methods and properties of a class."""
    if not inspect.isclass(value) or issubclass(value, enum.Enum):
        return []
    kinds = (property, cached_property, classmethod, staticmethod)
    defined = {name: member for base in own_classes(value) for name, member in vars(base).items()}
    return [
        name
        for name, member in defined.items()
        if not name.startswith("_") and (inspect.isfunction(member) or isinstance(member, kinds))
    ]


def _documented():
    """Return the dotted names that the reference documents, members included."""
    objects = [dotted for listed in (names(), records()) for page in listed.values() for dotted in page]
    return {*objects, *(f"{dotted}.{member}" for dotted in objects for member in members(load(dotted)))}


DOCUMENTED = _documented()
PACKAGES = {"jv": "jaxvibro", "co": "continuation"}  # by the names that the examples import them under
SHORT = {dotted.rpartition(".")[2]: dotted for page in records().values() for dotted in page}


def target(name, module="jaxvibro"):
    """Return the dotted name that the reference documents for a name as a text in a module writes it, or None."""
    head, dot, rest = name.partition(".")
    root = module.split(".")[0]
    heads = [f"{module}.{head}", f"{root}.{head}", PACKAGES.get(head, head)]
    heads += [SHORT[head]] if head in SHORT and root == "jaxvibro" else []
    return next((found + dot + rest for found in heads if found + dot + rest in DOCUMENTED), None)


def pages():
    """Return the text of each page of the reference: {file name: reStructuredText}."""
    returned = records()
    written = {f"{page}.rst": _page(SUBJECTS[page], public, returned[page]) for page, public in names().items()}
    examples, listed = _indent(EXAMPLES), _indent("\n".join(SUBJECTS))
    return {"index.rst": INDEX.format(examples=examples, pages=listed), **written}


def _page(title, public, returned):
    parts = [_heading(title, "="), *_entries(public)]
    if returned:
        parts += [_heading("Records that these calls return", "-"), *_entries(returned)]
    return "\n\n".join(parts) + "\n"


def _heading(title, mark):
    return f"{title}\n{mark * len(title)}"


def _entries(listed):
    """Return a table of names with their summaries, and the directives that document them."""
    table = ".. autosummary::\n   :nosignatures:\n\n" + _indent("\n".join(f"~{dotted}" for dotted in listed))
    return [table, *map(_directive, listed)]


def _directive(dotted):
    value = load(dotted)
    if not inspect.isclass(value):
        return f".. autofunction:: {dotted}"
    if issubclass(value, Exception):
        return f".. autoexception:: {dotted}"
    inherits = "\n   :inherited-members: ABC, Generic" if own_classes(value)[:-1] else ""
    return f".. autoclass:: {dotted}\n   :members:{inherits}"


def _indent(text):
    return "\n".join(f"   {line}".rstrip() for line in text.splitlines())
