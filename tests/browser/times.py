"""Waiting times of the page, measured within Chromium: `python -m tests.browser.times [COUNT]`."""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from .served import ROOT, Seen, Server, chromium

SCENE = ROOT / "scenes" / "fig4.toml"
STARTS = 5
FIRST, PAUSE = 2, 20_000  # uses of each kind before a pause, ms, in which the server compiles the evaluated functions
# Milliseconds from an action, `begin`, until the picture of a panel is another one and decoded.
WATCH = """([panel, begin]) => new Promise((done) => {
    const img = document.querySelector(`#${panel} img`), before = img.src;
    const watch = new MutationObserver(async () => {
        if (img.src === before) return;
        watch.disconnect();
        await img.decode();
        done(performance.now() - start);
    });
    watch.observe(img, { attributes: true, attributeFilter: ["src"] });
    const start = performance.now();
    const at = document.getElementById(begin.at);
    if (begin.value !== undefined) { at.value = begin.value; at.dispatchEvent(new Event("input")); }
    else if (begin.call) document.querySelector(`[data-call=${begin.call}]`).click();
    else for (const kind of ["pointerdown", "pointerup"])
        at.dispatchEvent(new PointerEvent(kind, { pointerId: 1, button: 0, clientX: begin.x, clientY: begin.y }));
})"""


def clicks(seen, count):
    """Click along the branch P111, no two in a row near each other: at one point the picture would stay."""
    seen.page.mouse.move(*seen.pixel("diagram", 3.0, 0.7))
    for amplitude in 0.7 + 2.6 * (0.618034 * np.arange(count) % 1.0):
        x, y = seen.pixel("diagram", amplitude, 0.72)
        yield "portrait", {"at": "diagram", "x": x, "y": y}


def slides(seen, count):
    """Move the slider of the damping."""
    for damping in np.linspace(0.051, 0.09, count):
        yield "portrait", {"at": "slider_damping", "value": damping}
    seen.page.dispatch_event("#slider_damping", "change")


def branches(seen, count):
    """Follow the branch of an orbit at one damping after another: each scene has none yet."""
    for damping in np.linspace(0.0505, 0.0895, count):
        seen.page.fill("#number_damping", f"{damping:.6f}")
        seen.page.dispatch_event("#number_damping", "change")
        seen.rest()
        yield "diagram", {"call": "follow"}


ACTIONS = {
    "click in the diagram to its portrait": clicks,
    "slider to the portrait": slides,
    "branch of an orbit to the diagram": branches,
}
STARTED = {
    "start to controls": "jaxvibro.state.sliders",
    "start to a portrait": "document.querySelector('#portrait img').naturalWidth",
}


def start_times(browser, home):
    """Return the seconds from the start of the command to a page with controls, and to one that shows an orbit."""
    begun = time.perf_counter()
    with Server(SCENE, home) as server:
        seen, waits = Seen(browser, server.url, wait=False), []
        for condition in STARTED.values():
            seen.until(condition)
            waits.append(time.perf_counter() - begun)
        seen.context.close()
    return waits


def action_times(seen, actions, count):
    """Return the milliseconds of a number of actions, warm."""
    waits = []
    for k, (panel, begin) in enumerate(actions(seen, FIRST + count)):
        if k == FIRST:
            seen.page.wait_for_timeout(PAUSE)
        waits.append(seen.page.evaluate(WATCH, [panel, begin]))
        seen.rest()
    return waits[FIRST:]


def main(count="50"):
    with chromium() as browser, tempfile.TemporaryDirectory() as home:
        first, *others = [start_times(browser, Path(home)) for _ in range(1 + STARTS)]
        for name, cold, *waits in zip(STARTED, first, *others, strict=True):
            middle = np.median(waits)
            print(f"{name:40}{middle:8.2f} s ({min(waits):.2f} to {max(waits):.2f}), at first {cold:.2f} s", flush=True)
        with Server(SCENE, Path(home)) as server:
            seen = Seen(browser, server.url)
            for name, actions in ACTIONS.items():
                low, middle, high = np.percentile(action_times(seen, actions, int(count)), [25, 50, 75])
                print(f"{name:40}{middle:8.0f} ms (quartiles {low:.0f} and {high:.0f}, {count} of them)", flush=True)
            seen.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
