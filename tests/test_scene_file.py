"""Scene files: strict reading of every table, limits of texts, defaults, and changes from the command line."""

import random
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvibro as jv
from jaxvibro.studies.scene_file import parse_limited_toml, read_scene_file
from tests.scene_files import SCENE, SCENES, refusal

FIG4, BRANCHES, LOCI = (SCENES / f"{name}.toml" for name in ("fig4", "branches", "loci"))
EXPLORE = "explore={parameter='amplitude', bounds=[0.0, 4.0], at={damping=0.06}, budget=7}"


def test_fig4_says_what_the_figure_shows():
    file, scene = read_scene_file(FIG4), jv.load_scene(FIG4)
    assert [float(scene.parameter(name)) for name in ("frequency", "damping", "restitution")] == [2.1, 0.05, 0.7]
    assert (scene.left.position, scene.right.position, scene.left.restitution) == (-1.0, 1.0, None)
    sweep = file.sweep
    assert (sweep.parameter, sweep.count, sweep.settle, sweep.keep) == ("amplitude", 1201, 300, 100)
    assert [(leg.name, leg.first, leg.last, leg.start.x, leg.start.v) for leg in sweep.legs] == [
        ("down", 6.0, 0.0, 0.9, -1.1),
        ("up", 0.0, 6.0, 0.0, 0.0),
    ]
    values = sweep.values(sweep.legs[0])
    assert (values[0], values[-1], len(values)) == (6.0, 0.0, 1201)
    assert (file.attractors.starts, file.attractors.seed, file.attractors.at) == (200, 0, {"amplitude": 4.65})


def test_reading_needs_no_double_precision_until_the_scene_is_made():
    with jax.enable_x64(False):
        assert read_scene_file(FIG4).scene.amplitude == 4.65
        assert jv.load_scene(FIG4, dtype=jnp.float32).dtype == jnp.float32
        with pytest.raises(jv.SceneError, match="jax_enable_x64"):
            jv.load_scene(FIG4)


def test_a_file_needs_no_restitution_if_each_rigid_wall_has_its_own(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(
        "[scene]\namplitude = 1.0\nfrequency = 2.1\ndamping = 0.05\nright = {position = 1.0, restitution = 0.5}\n"
    )
    assert read_scene_file(path).scene.restitution is None
    assert float(jv.load_scene(path).parameter("right.restitution")) == 0.5
    path.write_text("[scene]\namplitude = 1.0\nfrequency = 2.1\ndamping = 0.05\nright = {position = 1.0}\n")
    with pytest.raises(jv.SceneError, match=r"^scene\.restitution: must be given, unless each rigid wall has its own"):
        read_scene_file(path)


@pytest.mark.parametrize("number", [-0.0, 5e-324, 1e300, 0.1, 1.0 / 3.0])
def test_numbers_of_any_size_are_written_with_all_their_digits(number, tmp_path):
    walls = jv.Wall(-abs(number) - 1.0, motion=jv.Motion(0.4 * min(abs(number), 1.0), number, 5)), None
    scene = jv.make_scene(number, abs(number) or 1.0, abs(number), 0.3, walls)
    jv.save_scene(scene, tmp_path / "scene.toml")
    loaded = jv.load_scene(tmp_path / "scene.toml")
    for name in scene.names:
        assert np.float64(loaded.parameter(name)).tobytes() == np.float64(scene.parameter(name)).tobytes()


ALONG = "{parameter='frequency', bounds=[1.0, 3.0]}"
LEG = "{name='a', from=1, to=2, start={x=0, v=0}}"


@pytest.mark.parametrize(
    ("table", "values"),
    [
        ("orbits = {}", {"max_period": 4, "starts": 200, "seed": 0, "at": {}}),
        ("attractors = {}", {"starts": 200, "seed": 0, "at": {}, "max_seconds": None}),
        (f"branch = {ALONG}", {"settle": 200, "max_period": 1, "largest_step": 0.1, "bounds": (1.0, 3.0), "at": {}}),
        (f"explore = {ALONG}", {"at": {}, "max_period": 8, "seed": 0, "budget": None}),
        (f"sweep = {{parameter='frequency', count=3, legs=[{LEG}]}}", {"settle": 300, "keep": 100}),
    ],
)
def test_tables_have_defaults(table, values, tmp_path):
    (tmp_path / "plain.toml").write_text(SCENE)
    asked = getattr(read_scene_file(tmp_path / "plain.toml", [table]), table.split()[0])
    assert {key: getattr(asked, key) for key in values} == values


def test_a_locus_has_defaults_and_may_follow_what_was_explored():
    locus = read_scene_file(LOCI, ["locus = {largest_step = 0.2}"]).locus
    assert locus.parameters == ("amplitude", "frequency") and locus.kinds == ("SN", "PD", "SB", "GR")
    assert locus.bounds == {"amplitude": (0.0, 12.0), "frequency": (1.2, 3.0)} and locus.largest_step == 0.2
    bounds = "{amplitude=[0, 9], damping=[0.01, 0.2]}"
    changes = [EXPLORE, f"locus={{parameters=['amplitude', 'damping'], bounds={bounds}}}"]
    file = read_scene_file(FIG4, changes)
    assert file.branch_table is file.explore and file.locus.bounds["damping"] == (0.01, 0.2)
    line = refusal(read_scene_file, FIG4, [*changes, "locus.bounds.damping=[0.01, 0.055]"])
    assert line.startswith("locus.bounds.damping: must contain the damping of [explore], 0")


def test_changes_go_in_before_the_check():
    changes = ["scene.amplitude=3", "scene.right.motion.amplitude=0.1", "sweep.legs.1.to=5"]
    changes += ["sweep.parameter='right.motion.phase'", "attractors.at.damping=0.1"]
    file = read_scene_file(FIG4, changes)
    assert (file.scene.amplitude, file.scene.right.motion.amplitude, file.orbits) == (3.0, 0.1, None)
    assert [leg.last for leg in file.sweep.legs] == [0.0, 5.0]
    assert file.attractors.at == {"amplitude": 4.65, "damping": 0.1}


def test_a_start_is_held_against_the_walls_at_phase_0_of_the_first_value():
    changes = ["scene.right.motion.amplitude=0.5", "sweep.parameter='right.position'", "sweep.legs.0.to=2.0"]
    changes += ["sweep.legs.0.start.x=6.4", "sweep.legs.1.from=3.0", "sweep.legs.1.start.x=3.5"]
    assert read_scene_file(FIG4, changes).sweep.legs[1].start.x == 3.5
    line = refusal(read_scene_file, FIG4, [*changes, "sweep.legs.1.start.x=3.6"])
    assert line.startswith("sweep.legs[1].start.x: ") and line.endswith(" at -1.0 and 3.5; got 3.6")


HUGE = f"1{400 * '0'}"
FINITE_PAIR = "two finite numbers, the first smaller"
FREQUENCY = "locus.bounds.frequency"
# The change to a file, the key that the error names, and what it says. Values of wrong types, numbers that are not
# finite and unknown keys are tried for each key in tests/properties/test_studies.py.
POSITIVE = "sweep.count", "sweep.keep", "attractors.starts", "orbits.starts", "orbits.max_period"
BAD = [
    (
        "scene.amplitud = 3",
        "scene.amplitud",
        "is not a key here, perhaps amplitude (amplitude, frequency, damping, res",
    ),
    ("scen = 3", "scen", "perhaps scene (scene, sweep, attractors, orbits, branch, explore, locus, "),
    ("scene.left.stifness = 3", "scene.left.stifness", "perhaps stiffness (position, restitution, stiffness, damping"),
    ("scene.left.stiffness = -3", "scene.left.stiffness", "must be greater than 0; got -3"),
    ("scene.left.damping = 3", "scene.left.damping", "must not be given for a wall without stiffness; got 3"),
    ("sweep.steps = 3", "sweep.steps", "is not a key here (parameter, count, settle, keep, legs, max_seconds)"),
    ("'a\tb`x - at `$.c`' = 1", "a\tb`x - at `$.c`", "is not a key here"),
    ("'a` - at `$.c' = 1", "a` - at `$.c", "is not a key here"),
    ("sweep.legs = [{name='a', from=1, to=2}]", "sweep.legs[0].start", "must be given"),
    ("scene.left.motion = {phase=0.1}", "scene.left.motion.amplitude", "must be given"),
    ("scene.amplitude = '4.65'", "scene.amplitude", "must be a number; got '4.65'"),
    ("scene.amplitude = true", "scene.amplitude", "must be a number; got True"),
    ("scene.amplitude = 2007-01-01", "scene.amplitude", "must be a number"),
    (f"scene.amplitude = {HUGE}", "scene.amplitude", "Number out of range"),
    (f"scene.amplitude = 0x1{9000 * '0'}", "scene.amplitude", "a whole number too long to show"),
    ("scene.amplitude", "scene.amplitude", "must be KEY=VALUE with a TOML value"),
    ("scene.amplitude = large", "scene.amplitude", "must be KEY=VALUE with a TOML value"),
    ("scene.frequency = 0", "scene.frequency", "must be greater than 0; got 0.0"),
    ("scene.damping = -0.05", "scene.damping", "must not be negative; got -0.05"),
    ("scene.right.restitution = 1.7", "scene.right.restitution", "must lie between 0 and 1; got 1.7"),
    ("scene.right.position = -2", "scene.right.position", "must lie to the right of left.position; got -2.0"),
    ("scene.right.motion.amplitude = 2.5", "scene.right.motion", "must not touch or cross in their motion"),
    ("scene.right.motion = {amplitude=0.1, harmonic=0}", "scene.right.motion.harmonic", "whole number from 1 to 1000"),
    ("scene.right.motion = {amplitude=0.1, harmonic=1.5}", "scene.right.motion.harmonic", "whole number; got 1.5"),
    ("sweep.parameter = 'left.motion.phase'", "sweep.parameter", "a parameter of the scene, perhaps left.position"),
    ("sweep.parameter = 'restitution'", "sweep.legs[0] from 6.0 to 0.0: restitution", "got 6.0 at index (0,)"),
    ("sweep.count = 1000000000000", "sweep.count", "must be a whole number <= 1000000"),
    ("sweep.legs = []", "sweep.legs", "must be a list of length >= 1; got []"),
    ("sweep.legs.7.to = 3", "sweep.legs.7", "is not a key here (name, from, to, start)"),
    ("sweep.legs.0.name = 'up'", "sweep.legs[1].name", "must differ from the other legs' names; got 'up'"),
    ("sweep.legs.0.name = ''", "sweep.legs[0].name", "must be a text of length >= 1; got ''"),
    ("sweep.legs.0.start.x = 1.01", "sweep.legs[0].start.x", "must lie between the walls, at -1.0 and 1.0"),
    *((f"{key} = 0", key, "must be a whole number >= 1; got 0") for key in POSITIVE),
    ("attractors.at.force = 1", "attractors.at.force", "not a parameter of this scene, perhaps amplitude ("),
    (f"attractors.at.damping = {HUGE}", "attractors.at.damping", "Number out of range"),
    ("attractors.at.'right.restitution' = 2", "attractors.at.right.restitution", "must lie between 0 and 1; got 2.0"),
    ("orbits.max_period = 33", "orbits.max_period", "must be a whole number <= 32; got 33"),
    ("orbits.at.frequency = 0", "orbits.at.frequency", "must be greater than 0; got 0.0"),
    ("panels.speed = [1.0]", "panels.speed", "must be a parameter"),
    ("panels = {amplitude = [1.0, 2.0], damping = [0.1]}", "panels", "must give equally many values"),
    ("panels.amplitude = []", "panels", "must give equally many values"),
    ("panels.damping = [0.1, -1.0]", "panels.damping", "must not be negative"),
    ("spectrum = {parameter='size', from=0, to=1, count=3}", "spectrum.parameter", "must be a parameter"),
    ("spectrum = {parameter='amplitude', from=0, to=1, count=3, error=0.0}", "spectrum.error", "greater than 0"),
    ("basins = {x=[0, 1.5], v=[-1, 1], count=9}", "basins.x", "must lie between the walls"),
    ("basins = {x=[0, 1], v=[1, -1], count=9}", "basins.v", FINITE_PAIR),
]
BAD_BRANCH = [
    ("branch.parameter = 'force'", "branch.parameter", "must be a parameter of the scene"),
    ("branch.bounds = [1.0]", "branch.bounds", "must be a list of length 2; got [1.0]"),
    ("branch.bounds = [6, 0]", "branch.bounds", f"{FINITE_PAIR}; got [6.0, 0.0]"),
    ("branch.bounds = [2, 2]", "branch.bounds", f"{FINITE_PAIR}; got [2.0, 2.0]"),
    ("branch.bounds = [3, 6]", "branch.at.amplitude", "must lie within branch.bounds, 3.0 and 6.0; got 2.0"),
    ("branch.parameter = 'damping'\nbranch.bounds=[1, 2]", "branch.bounds", "must contain the scene's damping, 0.05"),
    ("branch.at.frequency = 0", "branch.at.frequency", "must be greater than 0; got 0.0"),
    ("branch.start.x = 1.01", "branch.start.x", "must lie between the walls, at -1.0 and 1.0; got 1.01"),
    ("branch.max_period = 0", "branch.max_period", "must be a whole number >= 1; got 0"),
    ("branch.max_period = 33", "branch.max_period", "must be a whole number <= 32; got 33"),
    ("branch.largest_step = 0", "branch.largest_step", "must be greater than 0; got 0.0"),
]
BAD_EXPLORE = [
    ("branch = {parameter='amplitude', bounds=[0, 6]}", "explore", "must not be given together with [branch]; got 'am"),
    ("explore.bounds = [4, 0]", "explore.bounds", f"{FINITE_PAIR}; got [4.0, 0.0]"),
    ("explore.at.damping = -1", "explore.at.damping", "must not be negative; got -1.0"),
    ("explore.max_period = 33", "explore.max_period", "must be a whole number <= 32; got 33"),
    ("explore.budget = 0", "explore.budget", "must be a whole number >= 1; got 0"),
]
BAD_LOCUS = [
    ("locus.parameters = ['amplitude']", "locus.parameters", "must be a list of length 2; got ['amplitude']"),
    ("locus.parameters = ['amplitude', 'force']", "locus.parameters[1]", "must be a parameter of the scene"),
    ("locus.parameters = ['damping', 'damping']", "locus.parameters", "must be two different parameters; got ['dampi"),
    ("locus.parameters = ['amplitude', 'damping']", "locus.bounds", "for amplitude and for damping only; got 'amp"),
    ("locus.bounds.damping = [0, 1]", "locus.bounds", "must give [low, high] for amplitude and for frequency only"),
    (f"{FREQUENCY} = [1.2, 'high']", f"{FREQUENCY}[1]", "must be a number; got 'high'"),
    (f"{FREQUENCY} = [3, 1]", FREQUENCY, "the first smaller; got [3.0, 1.0]"),
    (f"{FREQUENCY} = [2.2, 3]", FREQUENCY, "must contain the frequency of [branch], 2.1; got [2.2"),
    ("branch.at.frequency = 3.5", FREQUENCY, "must contain the frequency of [branch], 3.5; got [1.2, 3.0]"),
    ("locus.bounds.amplitude = [7, 9]", "locus.bounds.amplitude", "must overlap branch.bounds, 0.0 and 6.0; got [7.0"),
    ("locus.kinds = []", "locus.kinds", "must be a list of length >= 1; got []"),
    ("locus.kinds = ['SN', 'EP']", "locus.kinds[1]", "must be one of SN, PD, SB, GR; got 'EP'"),
    ("locus.kinds = ['SN', 'SN']", "locus.kinds[1]", "must differ from the others; got 'SN'"),
    ("locus.largest_step = 0", "locus.largest_step", "must be greater than 0; got 0.0"),
]
ALL_BAD = [(path, *row) for path, rows in ((FIG4, BAD), (BRANCHES, BAD_BRANCH), (LOCI, BAD_LOCUS)) for row in rows]
ALL_BAD += [(FIG4, [EXPLORE, change], *row) for change, *row in BAD_EXPLORE]


@pytest.mark.parametrize(
    ("path", "changes", "key", "said"), ALL_BAD, ids=[f"{place}-{row[2][:40]}" for place, row in enumerate(ALL_BAD)]
)
def test_a_bad_file_is_one_clear_line(path, changes, key, said):
    line = refusal(jv.run, path, "nowhere", [changes] if isinstance(changes, str) else changes)
    assert line.startswith(" ".join(key.split()) + ": ") and said in line, line
    assert not Path("nowhere").exists()


@pytest.mark.parametrize("content", [b"[scene", b"\xff\xfe\x00", b"a = 1\na = 2", b"a = " + b"[" * 7, b"a = \n1"])
def test_what_is_no_toml_is_refused_with_the_files_name(tmp_path, content):
    path = tmp_path / "mine.toml"
    with pytest.raises(FileNotFoundError):
        jv.load_scene(path)
    path.touch()
    with pytest.raises(jv.SceneError, match="scene: must be given"):
        jv.load_scene(path)
    path.write_bytes(content)
    with pytest.raises(jv.SceneError, match=r"^mine\.toml: must be a TOML file; got .*$"):
        jv.load_scene(path)


def test_loci_need_branches_and_keys_with_dots_are_named_whole(tmp_path):
    text, path = LOCI.read_text(), tmp_path / "other.toml"
    path.write_text(text[: text.index("[branch]")] + text[text.index("[locus]") :])
    line = refusal(read_scene_file, path)
    assert line.startswith("locus: must come with [branch] or [explore], whose special poin")
    old, new = "{amplitude = [0.0, 12.0], frequency = [1.2, 3.0]}", "{damping = [0, 1], 'right.position' = [0.9, 2]}"
    path.write_text(text.replace(old, new).replace('["amplitude", "frequency"]', '["damping", "right.position"]'))
    assert read_scene_file(path).locus.bounds == {"damping": (0.0, 1.0), "right.position": (0.9, 2.0)}
    line = refusal(read_scene_file, path, ["locus.bounds.'right.position'=[1, 'far']"])
    assert line.startswith("locus.bounds.right.position[1]: ")


DOTS = ".".join("abcdefghijkl")
SHALLOW = [
    f"# {DOTS} = 1",
    f'a = "{DOTS}"',
    f"a = '{DOTS}'",
    f'a = """\n{DOTS} = 1\n"""',
    f"a = '''\n{DOTS} = 1\n'''",
    f'"{DOTS}" = 1',
    'a = "' + "[{" * 20 + '"',
    'a = "\\"' + DOTS + '" # "',
    "a = [" + "[], " * 100 + "]",
    "# " + "[" * 100,
]
QUOTED = ['"#"', "'#'", '"""\n#"""', "'''\n#'''", '"\\""', "'\\'", '"""\\""""', "'''a'''''", '1 # "', "1 # '''"]


@pytest.mark.parametrize("depth", [1, 5, 8, 9, 12, 100, 20_000])
def test_a_key_is_at_most_eight_names_deep(depth):
    draw = random.Random(depth)
    for _ in range(20):
        names = [draw.choice(["a", '"b.c"', "'d'", "left", "-", "1"]) for _ in range(depth)]
        cut, blank = draw.randrange(depth), draw.choice(["", " ", "\t "])
        dotted, rest = f"{blank}.{blank}".join(names[: cut + 1]), names[cut + 1 :]
        text = dotted + "=" + "".join(f"{{{name}=" for name in rest) + "1" + "}" * len(rest)
        if max(cut + 1, len(rest)) > 8:
            assert "at most 8" in refusal(parse_limited_toml, "it", text)
        else:
            assert parse_limited_toml("it", text) == tomllib.loads(text)


def test_quoted_and_commented_texts_are_not_deep_and_hide_nothing():
    for text in SHALLOW:
        assert parse_limited_toml("it", text) == tomllib.loads(text)
    for text in QUOTED:
        assert "8 names" in refusal(parse_limited_toml, "it", f"a = {text}\n{DOTS} = 1")


def test_large_files_and_other_encodings_are_refused(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(SCENE + "#" * (1_000_000 - len(SCENE)))
    assert jv.load_scene(path).amplitude == 4.65
    path.write_text(SCENE + "#" * (1_000_001 - len(SCENE)))
    assert "must be at most 1,000,000 bytes" in refusal(jv.load_scene, path)
    for encoding in ("utf-8-sig", "utf-8", "utf-16", "utf-16-le", "utf-32", "latin-1", "cp037"):
        path.write_bytes(("# \xe9\n" + SCENE).encode(encoding))
        if encoding.startswith("utf-8"):
            assert jv.load_scene(path).amplitude == 4.65
        else:
            assert refusal(jv.load_scene, path).startswith("mine.toml: must be a TOML file")
