"""The pictures of docs/explorer.md, of the real page: `python -m docs.site.screenshots`."""

import io
import tempfile
from pathlib import Path

from PIL import Image

from tests.browser.served import ROOT, Seen, chromium, served

COLOURS = 256  # of a kept picture
LARGEST = 250_000  # bytes
WIDE, NARROW = {"width": 1400, "height": 900}, {"width": 400, "height": 860}


def explored(seen):
    """Figure 4 as it is explored by itself."""
    seen.at_rest()
    _keep(seen, "explored")


def special(seen):
    """The period doubling of the lopsided motion with three impacts, chosen."""
    seen.page.click("#points button:has-text('PD 4.787')")
    seen.at_rest()
    _keep(seen, "special")


def basins(seen):
    """What the starts at A = 4.65 settle on, behind one of the orbits."""
    seen.page.fill("#number_amplitude", "4.65")
    seen.page.keyboard.press("Enter")
    seen.at_rest()
    _asked(seen, "basins")
    _keep(seen, "basins", "#portrait")


def locus(seen):
    """The saddle-node in two parameters, over a map."""
    seen.page.click("#points button:has-text('SN 4.525')")
    seen.at_rest()
    _asked(seen, "locus")
    _asked(seen, "map")
    _keep(seen, "locus", "#plane")


def narrow(seen):
    """The same page in a window of a telephone's width."""
    before = seen.page.evaluate("() => jaxvibro.pictures.portrait")
    seen.page.set_viewport_size(NARROW)
    seen.until(f"jaxvibro.pictures.portrait > {before} && jaxvibro.idle")
    seen.page.wait_for_timeout(500)
    seen.at_rest()
    _keep(seen, "narrow")


def _asked(seen, call):
    """A choice from the menu, until its last round is there."""
    seen.page.click(f"#actions [data-call={call}]")
    seen.until("jaxvibro.state.works.length")
    seen.at_rest()


def _keep(seen, name, part=None):
    """The window, or a part of the page, as docs/explorer_NAME.png."""
    seen.page.mouse.move(0, 0)
    one = Image.open(io.BytesIO((seen.page.locator(part) if part else seen.page).screenshot())).convert("RGB")
    path = ROOT / "docs" / f"explorer_{name}.png"
    one.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    assert path.stat().st_size < LARGEST, f"{path.name} has {path.stat().st_size} bytes"


def main():
    scene = ROOT / "scenes" / "fig4.toml"
    with chromium() as browser, tempfile.TemporaryDirectory() as home, served(scene, Path(home)) as server:
        seen = Seen(browser, server.url, viewport=WIDE)
        for step in (explored, special, basins, locus, narrow):
            step(seen)
        seen.ends()


if __name__ == "__main__":
    main()
