"""Actions of a user on the page with pointer and keys, and their results, compared with those of jv alone."""

import re

import numpy as np
import pytest

import jaxvibro as jv

from .served import Seen

pytestmark = pytest.mark.browser

NUMBER = r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?"
DRAWN = "() => jaxvibro.pictures.portrait"
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


def find_orbit(amplitude, frequency=2.1, damping=0.05, restitution=0.7, start=(0.9, -1.1), **options):
    """Return the orbit of two walls that jv alone finds."""
    scene = jv.make_scene(amplitude, frequency, damping, restitution, (-1.0, 1.0))
    return jv.find_orbit(scene, jv.State(*start), **options)


def check_orbit(seen, label="P111"):
    """Check that the state and the multipliers on the page are those of an orbit of jv alone."""
    facts, numbers = seen.state("facts"), seen.state("numbers")
    x, v = map(float, re.search(rf"x ({NUMBER}), v ({NUMBER}) at phase 0", facts).groups())
    numbers = {name: numbers[name] for name in ("amplitude", "frequency", "damping", "restitution")}
    orbit = find_orbit(**numbers, start=(x, v), settle=0, periods=1)
    assert orbit.label == label
    np.testing.assert_allclose([x, v], [float(orbit.state.x), float(orbit.state.v)], rtol=1e-9)
    parts = re.search(rf"multipliers ({NUMBER})(?: \+- ({NUMBER})i|, ({NUMBER}))", facts).groups()
    first, imaginary, second = (float(part) if part else None for part in parts)
    shown = [first, second] if imaginary is None else [complex(first, -imaginary), complex(first, imaginary)]
    np.testing.assert_allclose(sorted(shown, key=np.imag), sorted(orbit.multipliers.tolist(), key=np.imag), rtol=1e-5)


def branches_of(seen):
    """Return the names of the branches in the Python of the page."""
    return re.findall(r"^(branch_\d+) = jv\.follow", seen.state("python"), re.MULTILINE)


def test_a_click_in_the_diagram_gives_the_orbit_there(seen):
    before = seen.page.evaluate(DRAWN)
    seen.click("diagram", 2.75, 0.72)
    assert seen.page.evaluate(DRAWN) > before
    assert abs(seen.state("numbers")["amplitude"] - 2.75) < 0.2 and seen.state("title") == "P111, stable"
    check_orbit(seen)


def test_a_click_near_a_special_point_and_a_choice_from_the_list(seen):
    (sn,) = [point for point in seen.state("points") if point["kind"] == "SN"]
    point = jv.follow(find_orbit(2.0), "amplitude", (0.0, 6.0)).points("SN")[0]
    assert sn["value"] == pytest.approx(point.value, rel=1e-9)
    seen.click("diagram", sn["value"], float(point.orbit.state.x))
    assert seen.state("chosen") == sn["of"] and seen.state("actions")[0]["call"] == "locus"
    assert seen.page.locator("#points [aria-current=true]").inner_text().startswith("SN 0.508")
    seen.page.click("#points button:has-text('SB')")
    seen.until("jaxvibro.state.facts.startsWith('SB')")
    seen.page.click("#actions [data-call=switch]")
    seen.until("jaxvibro.state.python.includes('jv.switch')")
    seen.rest()
    assert re.search(r"branches_1 = jv\.switch\(branch_1\.special\[\d\]\)", seen.state("python"))


def test_a_drag_looks_closer_and_a_double_click_goes_back(seen):
    facts = seen.state("facts")
    seen.drag(seen.pixel("diagram", 1.0, -0.5), seen.pixel("diagram", 3.0, 0.5))
    limits = seen.page.evaluate("() => [panels.diagram.x, panels.diagram.y]")
    np.testing.assert_allclose(limits, [[1.0, 3.0], [-0.5, 0.5]], atol=0.02)
    assert seen.state("facts") == facts
    seen.page.mouse.dblclick(*seen.pixel("diagram", 2.0, 0.0))
    seen.until("jaxvibro.idle && panels.diagram.x[1] === 6")
    assert seen.page.evaluate("() => panels.diagram.x") == [0.0, 6.0]


def test_a_slider_moves_the_orbit_by_keys_and_by_the_pointer(seen):
    before = seen.page.evaluate(DRAWN)
    seen.page.focus("#slider_damping")
    for _ in range(3):
        seen.page.keyboard.press("ArrowRight")
    seen.rest()
    damping = seen.state("numbers")["damping"]
    assert damping == pytest.approx(0.05 + 3 * 0.5 / 1000, abs=3e-4)
    assert float(seen.page.input_value("#number_damping")) == pytest.approx(damping, rel=1e-9)
    assert seen.page.evaluate(DRAWN) > before
    check_orbit(seen)
    area = seen.page.locator("#slider_amplitude").bounding_box()
    down = area["y"] + area["height"] / 2
    seen.drag((area["x"] + area["width"] / 2, down), (area["x"] + 0.7 * area["width"], down))
    assert seen.state("numbers")["amplitude"] == pytest.approx(2.8, abs=0.15)
    check_orbit(seen)
    seen.page.click("#undo")  # the whole motion is one step
    seen.rest()
    assert seen.state("numbers")["amplitude"] == 2.0


def test_the_menu_adds_a_branch_and_undo_takes_it_back(seen):
    seen.enter("damping", "0.06")
    assert seen.state("numbers")["damping"] == 0.06
    assert seen.state("points") == [] and len(branches_of(seen)) == 1
    seen.page.mouse.click(*seen.pixel("diagram", 2.0, 0.9), button="right")
    seen.page.click("#popup button:has-text('branch of P111')")
    seen.until("jaxvibro.state.points.length")
    seen.rest()
    assert len(branches_of(seen)) == 2
    branch = jv.follow(find_orbit(2.0, damping=0.06), "amplitude", (0.0, 6.0))
    shown = {point["kind"]: point["value"] for point in seen.state("points")}
    for kind in ("SN", "SB"):
        assert shown[kind] == pytest.approx(branch.points(kind)[0].value, rel=1e-8)
    seen.page.click("#undo")
    seen.rest()
    assert seen.state("points") == [] and len(branches_of(seen)) == 1


def test_keys_alone(seen):
    for _ in range(40):
        seen.page.keyboard.press("Tab")
        if seen.page.evaluate("() => document.activeElement.id") == "diagram":
            break
    assert seen.page.evaluate("() => document.activeElement.id") == "diagram"
    for _ in range(3):
        seen.page.keyboard.press("ArrowRight")
    seen.until("jaxvibro.idle && jaxvibro.state.facts.startsWith('point ')")
    facts = seen.state("facts")
    seen.page.keyboard.press("f")
    seen.until("document.getElementById('told').innerText.includes('that is not on a branch')")
    seen.page.keyboard.press("u")
    seen.rest()
    assert branches_of(seen) == ["branch_1"] and seen.state("facts") != facts


def test_a_thousand_clicks_in_a_second_end_with_the_last(seen):
    first, last = seen.pixel("diagram", 1.0, 0.5), seen.pixel("diagram", 2.9, 0.73)
    seen.page.mouse.move(*first)
    seen.page.evaluate(CLICKS, [first, last, 1000])
    seen.rest()
    assert seen.state("numbers")["amplitude"] == pytest.approx(2.9, abs=0.2)
    assert seen.page.inner_text("#told") == ""
    check_orbit(seen)


def test_other_axes_and_a_line_for_each_error(seen):
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
    seen.page.fill("#low", "1")
    seen.page.select_option("#variable", "v")
    seen.page.click("#along button")
    seen.until("jaxvibro.idle && panels.diagram.x[0] === 1")
    assert seen.state("along")["bounds"] == [1.0, 6.0] and seen.state("along")["variable"] == "v"
    (mark,) = seen.state("marks")["diagram"]
    velocity = float(re.search(rf", v ({NUMBER})", seen.state("facts"))[1])
    np.testing.assert_allclose(mark, [2.0, velocity], rtol=1e-9)
    seen.click("diagram", 2.75, velocity)
    assert seen.page.inner_text("#told") == ""


@pytest.mark.parametrize("width", [400, 800])
def test_nothing_stands_out_of_a_narrow_window(browser, server, width):
    seen = Seen(browser, server.url, width=width)
    assert seen.page.evaluate("() => document.documentElement.scrollWidth") <= width
    seen.page.click("#files summary")
    area = seen.page.locator("#files menu").bounding_box()
    assert area["x"] >= 0 and area["x"] + area["width"] <= width
    seen.close()


def test_two_pages_do_not_disturb_each_other(browser, server, seen):
    other = Seen(browser, server.url)
    seen.enter("amplitude", "2.5")
    other.click("portrait", -0.586, 0.0)
    assert [page.state("numbers")["amplitude"] for page in (seen, other)] == [2.5, 2.0]
    check_orbit(seen)
    check_orbit(other, "P100")
    other.close()
