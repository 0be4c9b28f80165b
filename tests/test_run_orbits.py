"""The table [orbits] of a scene file: what a run of it tells, writes and draws."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import xarray as xr

import jaxvibro as jv
from jaxvibro import plot
from jaxvibro.studies import result_pictures, results_dataset, results_report, scene_file, scene_file_studies
from tests.scene_files import SCENE

SCENE_FILE = Path(__file__).parents[1] / "scenes" / "branches.toml"
ORBITS = """
[orbits]
max_period = 1
starts = 20
"""


@pytest.fixture(scope="module")
def orbited(tmp_path_factory):
    """The folder of a run that asks for orbits alone, at A = 4.65, and its summary."""
    out = tmp_path_factory.mktemp("orbits")
    (out / "orbits.toml").write_text(SCENE + ORBITS)
    return out, jv.run(out / "orbits.toml", out / "out")


def test_orbits_are_told_with_their_multipliers(orbited):
    told, table = orbited[1].summary, orbited[1].table
    assert "stretches" not in told and "attractors" not in told
    found = told["orbits"]
    assert [one["label"] for one in found] == 3 * ["P111"] + 2 * ["P112"] + 2 * ["P121"]
    assert [one["mirror_of"] for one in found] == [1, 0, 2, 5, 6, 3, 4]
    roots = {(one["label"], one["stable"]): one["multipliers"] for one in found}
    np.testing.assert_allclose(roots["P111", True], [[-0.111244, 0.406986], [-0.111244, -0.406986]], atol=1e-6)
    np.testing.assert_allclose(roots["P111", False], [[2.333002, 0.0], [0.076302, 0.0]], atol=1e-6)
    for label in ("P112", "P121"):
        np.testing.assert_allclose(roots[label, True], [[-0.400941, 0.0], [-0.217554, 0.0]], atol=1e-6)
        np.testing.assert_allclose(roots[label, False], [[4.759687, 0.0], [0.018326, 0.0]], atol=1e-6)
    assert all(one["residual"] < 1e-13 and one["least_speed"] > 0.5 for one in found)
    assert found[2]["least_clearance"] is None and found[2]["itinerary"] == ["RL"]
    lines = [" ".join(line.split()) for line in table.splitlines()]
    assert "1 P111 stable -0.1112439 +- 0.4069862i" in next(line for line in lines if line.startswith("1 P111"))
    (line,) = (line for line in lines if line.startswith("3 P111"))
    assert line.startswith("3 P111 unstable 2.333002, 0.0763021 0.738379306639 2.619343180748 RL 2.94569 inf ")
    assert line.endswith(" itself")


def test_the_data_hold_the_orbits(orbited):
    out, told = orbited[0] / "out", orbited[1].summary["orbits"]
    assert {one.name for one in out.iterdir()} == {"orbits.png", "orbits.nc", "orbits.txt"}
    with xr.open_dataset(out / "orbits.nc", engine="scipy") as data:
        assert dict(data.sizes) == {"orbit": 7, "multiplier": 2}
        assert data["orbit_label"].values.tolist() == [one["label"] for one in told]
        assert data["orbit_mirror"].values.tolist() == [one["mirror_of"] for one in told]
        assert data["orbit_stable"].values.tolist() == [1, 1, 0, 0, 1, 0, 1]
        both = np.stack([data["orbit_multiplier_real"], data["orbit_multiplier_imag"]], -1)
        np.testing.assert_array_equal(both, [one["multipliers"] for one in told])
        for key in ("x", "v", "phase"):
            np.testing.assert_array_equal(data[f"orbit_{key}"], [one["state"][key] for one in told])
        units = [data[f"orbit_{key}"].attrs["units"] for key in ("x", "v", "phase", "multiplier_real", "least_speed")]
        assert units == ["length", "length w0", "rad", "1", "length w0"]


def unbranched(*changes):
    """Figure 4's file with these changes, without its branches."""
    return msgspec.structs.replace(scene_file.read_scene_file(SCENE_FILE, changes), branch=None)


@pytest.fixture(scope="module")
def beside():
    """Attractors and orbits of one scene beside a sweep."""
    changes = [f"sweep.{key}=5" for key in ("count", "settle", "keep")] + ["attractors.starts=50"]
    return scene_file_studies.run_studies(unbranched(*changes, "orbits={max_period=1, starts=20, at={amplitude=4.65}}"))


def test_orbits_among_the_attractors_are_left_to_them(beside):
    assert beside.diagram_value(beside.file.attractors) == beside.diagram_value(beside.file.orbits) == 4.65
    assert [one.kind for one in beside.attractors] == 4 * ["periodic"] and len(beside.orbits) == 7
    assert [(one.label, one.stable) for one in beside.other_orbits] == [
        (label, False) for label in ("P111", "P112", "P121")
    ]
    assert [one.mirror_of for one in beside.other_orbits] == [0, 2, 1]


def test_a_diagram_gets_both_and_portraits_are_nine_at_most(beside, monkeypatch):
    marked, drawn = [], []
    monkeypatch.setattr(plot, "mark", lambda some, value, variable, ax, units: marked.append((len(some), value)))
    monkeypatch.setattr(plot, "mark_orbits", lambda some, value, variable, ax, units: marked.append((len(some), value)))
    monkeypatch.setattr(plot, "orbit", lambda one, ax, units: drawn.append(one.label))
    result_pictures.draw_main_picture(beside)
    assert marked == 2 * [(4, 4.65), (3, 4.65)] and drawn == []
    file = msgspec.structs.replace(beside.file, sweep=None, attractors=None)
    result_pictures.draw_main_picture(
        replace(beside, file=file, swept=None, attractors=None, orbits=beside.orbits + beside.orbits)
    )
    assert drawn == 3 * ["P111"] + 2 * ["P112"] + 2 * ["P121"] + 2 * ["P111"]


def test_a_state_at_another_phase_is_told_with_it(beside):
    state = jv.State(0.2, -0.4, 1.8, 0.0)
    table = results_report.format_results_table(
        replace(beside, orbits=(beside.orbits[0], replace(beside.orbits[3], state=state))), "name"
    )
    assert "x and v at the phase (rad) given" in table
    assert " 0.200000000000 -0.400000000000 1.800000000000 RLR " in " ".join(table.split())
    assert "x and v at phase 0;" in results_report.format_results_table(beside, "name")


def test_orbits_with_another_parameter_than_the_sweep_s_stay_out_of_the_diagram():
    file = unbranched("orbits={at={damping=0.1}}")
    found = scene_file_studies.StudyResults(file, file.scene.make(), None, (), ())
    assert found.diagram_value(file.orbits) is None and found.diagram_value(file.attractors) == 4.65
    assert (found.scene_of_table(file.orbits).damping, found.scene_of_table(file.attractors).amplitude) == (0.1, 4.65)


def test_a_scene_without_such_orbits_says_so():
    file = unbranched("orbits={}")
    found = scene_file_studies.StudyResults(
        msgspec.structs.replace(file, sweep=None, attractors=None), file.scene.make(), None, None, ()
    )
    assert "200 starts (seed 0): none found" in results_report.format_results_table(found, "name")
    assert results_report.summarise_results(found, {})["orbits"] == [] and result_pictures.draw_main_picture(
        found
    ).startswith(b"\x89PNG")
    assert results_dataset.make_results_dataset(found).sizes == {}
