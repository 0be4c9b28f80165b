"""What a user does on the page with pointer and keys, and what comes of it, against the same asked of jv alone."""

import re

import numpy as np
import pytest

import jaxvibro as jv

from .served import Seen

pytestmark = pytest.mark.browser

WALLS = (-1.0, 1.0)
NUMBER = r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?"
CLICKS = """([first, last, count]) => new Promise((done) => {
    const at = document.getElementById("diagram");
    let k = 0;
    const ten = () => {
        for (const end = Math.min(count, k + 10); k < end; k += 1) {
            const part = k / (count - 1);
            const [clientX, clientY] = [0, 1].map((i) => first[i] + part * (last[i] - first[i]));
            for (const kind of ["pointerdown", "pointerup"])
                at.dispatchEvent(new PointerEvent(kind, { pointerId: 1, button: 0, clientX, clientY, bubbles: true }));
        }
        if (k < count) setTimeout(ten, 10); else done();
    };
    ten();
})"""


def orbit_told(seen):
    """The orbit of jv alone that ought to be the one that the page tells of."""
    facts, numbers = seen.state("facts"), seen.state("numbers")
    x, v = map(float, re.search(rf"x ({NUMBER}), v ({NUMBER}) at phase 0", facts).groups())
    given = {name: numbers[name] for name in ("amplitude", "frequency", "damping", "restitution")}
    one = jv.find_orbit(jv.make_scene(**given, walls=WALLS), jv.State(x, v), 1, settle=0)
    np.testing.assert_allclose([x, v], [float(one.state.x), float(one.state.v)], rtol=1e-9)
    return one


def multipliers_told(seen):
    """The multipliers that the page tells: both, as complex numbers."""
    found = re.search(rf"multipliers ({NUMBER})(?: \+- ({NUMBER})i|, ({NUMBER}))", seen.state("facts"))
    first, imaginary, second = (float(one) if one else None for one in found.groups())
    return [first, second] if imaginary is None else [complex(first, -imaginary), complex(first, imaginary)]


def branches_of(seen):
    """The lines of the page that follow a branch."""
    return re.findall(r"^(branch_\d+) = jv\.follow", seen.state("python"), re.MULTILINE)


def test_a_click_in_the_diagram_gives_the_orbit_there(seen):
    before = seen.page.evaluate("() => jaxvibro.pictures.portrait")
    seen.click("diagram", 2.75, 0.72)
    assert seen.page.evaluate("() => jaxvibro.pictures.portrait") > before
    assert abs(seen.state("numbers")["amplitude"] - 2.75) < 0.2
    one = orbit_told(seen)
    assert one.label == "P111" and seen.state("title") == "P111, stable"
    told = sorted(multipliers_told(seen), key=np.imag)
    np.testing.assert_allclose(told, sorted(one.multipliers.tolist(), key=np.imag), rtol=1e-5)


def test_a_click_near_a_special_point_chooses_it(seen):
    (sn,) = [one for one in seen.state("points") if one["kind"] == "SN"]
    orbit = jv.find_orbit(jv.make_scene(2.0, 2.1, 0.05, 0.7, WALLS), jv.State(0.9, -1.1))
    branch = jv.follow(orbit, "amplitude", (0.0, 6.0))
    assert sn["value"] == pytest.approx(branch.points("SN")[0].value, rel=1e-9)
    seen.click("diagram", sn["value"], float(branch.points("SN")[0].orbit.state.x))
    assert seen.state("chosen") == sn["of"]
    assert [one["call"] for one in seen.state("actions")][:1] == ["locus"]
    assert seen.page.locator("#points [aria-current=true]").inner_text().startswith("SN 0.508")


def test_a_drag_looks_closer_and_a_double_click_goes_back(seen):
    facts = seen.state("facts")
    seen.drag("diagram", (1.0, -0.5), (3.0, 0.5))
    limits = seen.page.evaluate("() => [panels.diagram.x, panels.diagram.y]")
    np.testing.assert_allclose(limits, [[1.0, 3.0], [-0.5, 0.5]], atol=0.02)
    assert seen.state("facts") == facts
    seen.page.mouse.dblclick(*seen.pixel("diagram", 2.0, 0.0))
    seen.until("jaxvibro.idle && panels.diagram.x[1] === 6")
    assert seen.page.evaluate("() => panels.diagram.x") == [0.0, 6.0]


def test_a_slider_moves_the_orbit_by_keys(seen):
    before = seen.page.evaluate("() => jaxvibro.pictures.portrait")
    seen.page.focus("#slider_damping")
    for _ in range(3):
        seen.page.keyboard.press("ArrowRight")
    seen.at_rest()
    damping = seen.state("numbers")["damping"]
    assert damping == pytest.approx(0.05 + 3 * 0.5 / 1000, abs=3e-4)
    assert float(seen.page.input_value("#number_damping")) == pytest.approx(damping, rel=1e-9)
    assert seen.page.evaluate("() => jaxvibro.pictures.portrait") > before
    np.testing.assert_allclose(
        sorted(multipliers_told(seen), key=np.imag),
        sorted(orbit_told(seen).multipliers.tolist(), key=np.imag),
        rtol=1e-5,
    )


def test_a_slider_drawn_by_the_pointer_is_one_step(seen):
    area = seen.page.locator("#slider_amplitude").bounding_box()
    down = area["y"] + area["height"] / 2
    seen.page.mouse.move(area["x"] + area["width"] / 2, down)
    seen.page.mouse.down()
    seen.page.mouse.move(area["x"] + 0.7 * area["width"], down, steps=10)
    seen.page.mouse.up()
    seen.at_rest()
    assert seen.state("numbers")["amplitude"] == pytest.approx(2.8, abs=0.15)
    assert orbit_told(seen).label == "P111"
    seen.page.click("#undo")
    seen.at_rest()
    assert seen.state("numbers")["amplitude"] == 2.0


def test_a_number_is_typed(seen):
    seen.page.fill("#number_amplitude", "2.5")
    seen.page.keyboard.press("Enter")
    seen.at_rest()
    assert seen.state("numbers")["amplitude"] == 2.5
    assert orbit_told(seen).label == "P111"


def test_the_menu_adds_a_branch_and_undo_takes_it_back(seen):
    seen.page.fill("#number_damping", "0.06")
    seen.page.keyboard.press("Enter")
    seen.at_rest()
    assert seen.state("points") == [] and len(branches_of(seen)) == 1
    seen.page.mouse.click(*seen.pixel("diagram", 2.0, 0.9), button="right")
    seen.page.click("#popup button:has-text('branch of P111')")
    seen.until("jaxvibro.state.points.length")
    seen.at_rest()
    assert len(branches_of(seen)) == 2
    orbit = jv.find_orbit(jv.make_scene(2.0, 2.1, 0.06, 0.7, WALLS), jv.State(0.9, -1.1))
    alone = jv.follow(orbit, "amplitude", (0.0, 6.0))
    told = {one["kind"]: one["value"] for one in seen.state("points")}
    for kind in ("SN", "SB"):
        assert told[kind] == pytest.approx(alone.points(kind)[0].value, rel=1e-8)
    seen.page.click("#undo")
    seen.at_rest()
    assert seen.state("points") == [] and len(branches_of(seen)) == 1


def test_a_choice_from_a_special_point(seen):
    seen.page.click("#points button:has-text('SB')")
    seen.until("jaxvibro.state.facts.startsWith('SB')")
    seen.page.click("#actions [data-call=switch]")
    seen.until("jaxvibro.state.python.includes('jv.switch')")
    seen.at_rest()
    assert re.search(r"branches_1 = jv\.switch\(branch_1\.special\[\d\]\)", seen.state("python"))


def test_keys_alone(seen):
    for _ in range(40):
        seen.page.keyboard.press("Tab")
        if seen.page.evaluate("() => document.activeElement.id") == "diagram":
            break
    assert seen.page.evaluate("() => document.activeElement.id") == "diagram"
    for _ in range(3):
        seen.page.keyboard.press("ArrowRight")
    seen.until("jaxvibro.idle && jaxvibro.state.facts.startsWith('point ')")
    one = orbit_told(seen)
    assert f"{one.label}, " in seen.state("title")
    facts = seen.state("facts")
    seen.page.keyboard.press("f")
    seen.until("document.getElementById('told').innerText.includes('that is on no branch yet')")
    seen.page.keyboard.press("u")
    seen.at_rest()
    assert branches_of(seen) == ["branch_1"] and seen.state("facts") != facts


def test_a_thousand_clicks_in_a_second_end_with_the_last(seen):
    first, last = seen.pixel("diagram", 1.0, 0.5), seen.pixel("diagram", 2.9, 0.73)
    seen.page.mouse.move(*first)
    seen.page.evaluate(CLICKS, [first, last, 1000])
    seen.at_rest()
    assert seen.state("numbers")["amplitude"] == pytest.approx(2.9, abs=0.2)
    assert seen.page.inner_text("#told") == ""
    assert orbit_told(seen).label == "P111"


def test_other_axes(seen):
    seen.page.fill("#low", "1")
    seen.page.select_option("#variable", "v")
    seen.page.click("#along button")
    seen.until("jaxvibro.idle && panels.diagram.x[0] === 1")
    assert seen.state("along")["bounds"] == [1.0, 6.0] and seen.state("along")["variable"] == "v"
    facts = seen.state("facts")
    (mark,) = seen.state("marks")["diagram"]
    np.testing.assert_allclose(mark, [2.0, float(re.search(rf", v ({NUMBER})", facts)[1])], rtol=1e-9)


def test_what_cannot_be_is_told_in_a_line_and_the_page_goes_on(seen):
    seen.page.evaluate("() => send({ do: 'ask', call: 'map', count: 0 })")
    seen.until("document.getElementById('told').textContent.startsWith('message:')")
    seen.page.fill("#low", "7")
    seen.page.click("#along button")
    seen.until("document.getElementById('told').textContent.startsWith('bounds:')")
    assert seen.page.get_attribute("#told", "class") == "bad"
    seen.page.fill("#low", "")
    seen.page.click("#along button")
    assert seen.page.evaluate("() => document.activeElement.id") == "low"
    seen.page.fill("#number_left\\.position", "3")
    seen.page.keyboard.press("Enter")
    seen.until("jaxvibro.idle && !document.getElementById('told').textContent.startsWith('bounds:')")
    assert seen.state("numbers")["left.position"] == -1.0
    seen.click("diagram", 2.75, 0.72)
    assert orbit_told(seen).label == "P111" and seen.page.inner_text("#told") == ""


@pytest.mark.parametrize("width", [400, 800])
def test_nothing_stands_out_of_a_narrow_window(browser, server, width):
    seen = Seen(browser, server.url, viewport={"width": width, "height": 800})
    assert seen.page.evaluate("() => document.documentElement.scrollWidth") <= width
    seen.page.click("#files summary")
    area = seen.page.locator("#files menu").bounding_box()
    assert area["x"] >= 0 and area["x"] + area["width"] <= width
    seen.ends()


def test_two_pages_do_not_disturb_each_other(browser, server, seen):
    other = Seen(browser, server.url)
    seen.page.fill("#number_amplitude", "2.5")
    seen.page.keyboard.press("Enter")
    other.click("portrait", -0.586, 0.0)
    seen.at_rest()
    assert [one.state("numbers")["amplitude"] for one in (seen, other)] == [2.5, 2.0]
    assert [one.state("title").split(",")[0] for one in (seen, other)] == ["P111", "P100"]
    assert orbit_told(other).label == "P100"
    other.ends()
