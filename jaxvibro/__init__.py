"""Simulate driven impact oscillators, find attractors, locate bifurcations, and differentiate through all of it.

With a linear spring and damper, the motion between the impacts and inside soft walls is exact up to rounding, and
impacts are certified. A user-defined force is integrated numerically.
"""

import sys
from importlib import import_module

__version__ = "0.1.0"

# Module of each public name. A name is loaded at its first use, so that `jaxvibro --help` never imports jax.
_HOMES = {
    "Scene": "scene.scene",
    "Wall": "scene.scene",
    "Motion": "scene.scene",
    "make_scene": "scene.scene",
    "Force": "scene.force",
    "Push": "scene.push",
    "SceneError": "scene.check",
    "ArgumentError": "scene.check",
    "scene_from_physical": "scene.physical",
    "Scales": "scene.scales",
    "to_physical": "output.units",
    "soften": "scene.soft_walls",
    "effective_restitution": "scene.soft_walls",
    "contact_damping": "scene.soft_walls",
    "load_scene": "studies.scene_file",
    "save_scene": "studies.scene_file",
    "load_data": "output.checksums",
    "State": "scene.state",
    "Impacts": "scene.state",
    "strobe": "maps.strobe",
    "wall_loads": "maps.wall_loads",
    "monodromy": "maps.monodromy",
    "simulate": "maps.simulate",
    "sample": "maps.sample",
    "return_map": "maps.return_map",
    "Return": "maps.return_map",
    "sections": "maps.sections",
    "SolutionStatus": "scene.state",
    "find_orbit": "orbits.find",
    "find_orbits": "orbits.find",
    "solve_orbits": "orbits.solve",
    "OrbitSolutions": "orbits.solve",
    "Orbit": "orbits.orbit",
    "OrbitError": "orbits.orbit",
    "twist": "orbits.twist",
    "follow": "branches.follow",
    "follow_all": "branches.follow",
    "switch": "loci.switch",
    "extend": "branches.switch",
    "Branch": "branches.branch",
    "HeldBranch": "branches.held_branch",
    "load_branch": "branches.branch_file",
    "load_held_branch": "branches.branch_file",
    "scenario": "branches.scenario",
    "Scenario": "branches.scenario",
    "Follows": "branches.scenario",
    "OneImpact": "branches.scenario",
    "period_adding": "branches.scenario",
    "PeriodAdding": "branches.scenario",
    "PeriodicWindow": "branches.scenario",
    "peaks": "branches.peaks",
    "peak": "branches.peaks",
    "sensitivity": "design.point_sensitivity",
    "Search": "design.search",
    "search": "design.search",
    "located": "design.located",
    "Located": "design.located",
    "LocatedPoint": "design.located",
    "LocatedOrbit": "design.located",
    "OrbitOfScene": "design.located",
    "hysteresis": "design.hysteresis",
    "Hysteresis": "design.hysteresis",
    "HysteresisLoop": "design.hysteresis",
    "margin": "design.margin",
    "Margin": "design.margin_result",
    "NearPoint": "design.margin_result",
    "place": "design.place",
    "Placement": "design.place",
    "fit": "design.fit",
    "Fit": "design.fit_result",
    "FitStatus": "design.fit_result",
    "Combination": "design.fit_result",
    "ImpactRecord": "design.records",
    "SampleRecord": "design.records",
    "record_from_physical": "design.records",
    "PointRecord": "design.records",
    "locus": "loci.locus",
    "Locus": "loci.locus",
    "load_locus": "loci.locus",
    "family": "loci.family",
    "explore": "branches.explore",
    "find_isolas": "branches.isolas",
    "diagrams": "branches.diagram_family",
    "Diagram": "branches.diagram",
    "load_diagram": "branches.diagram",
    "sweep": "attractors.sweep",
    "find_attractors": "attractors.find",
    "spectrum": "attractors.spectrum",
    "basins": "attractors.basins",
    "fractions": "surveys.fractions",
    "manifold": "attractors.manifold",
    "map_parameters": "surveys.map",
    "Store": "stores.zarr_store",
    "load_store": "stores.zarr_store",
    "LocalEngine": "stores.engines",
    "DaskEngine": "stores.dask_engine",
    "Progress": "stores.study",
    "least_shock": "surveys.least_shock",
    "LeastShock": "surveys.least_shock",
    "view": "explorer.view",
    "run": "studies.run",
    "show": "studies.show_stored_map",
    "paper": "reproduction.run",
    "warm": "studies.warm",
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
