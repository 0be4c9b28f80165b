"""`view`: the explorer's page for a scene, served while the program or notebook goes on."""

import asyncio
import threading
from collections.abc import Sequence
from html import escape
from os import PathLike

from ..scene import check
from ..scene.scene import Scene
from ..scene.scene_table import make_scene_table, scene_toml_or_empty
from ..studies import scene_file
from ..studies.schema import SceneFile
from .server import Explorer

HEIGHT = 900  # pixels of the page within a notebook
LAST_PORT = 65535


class View:
    """A page that is served: url, its address with the token, for this machine alone. In a notebook it shows itself."""

    def __init__(self, explorer: Explorer) -> None:
        self.url = explorer.url
        self._explorer = explorer
        self._thread = threading.Thread(target=lambda: asyncio.run(explorer.serve()), daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Waits until the server has ended."""
        while self._thread.is_alive():
            self._thread.join(0.2)

    def stop(self) -> None:
        """Ends the server, and with it the work of its pages."""
        self._explorer.stop()
        self._thread.join(5.0)

    def __repr__(self) -> str:
        return f"View({self.url})"

    def _repr_html_(self) -> str:
        return f'<iframe src="{escape(self.url)}" width="100%" height="{HEIGHT}" title="jaxvibro"></iframe>'


@check.host_only("use the scene itself")
def view(
    scene: Scene | str | PathLike[str],
    port: int | None = None,
    address: str = "127.0.0.1",
    changes: Sequence[str] = (),
    token: str | None = None,
) -> View:
    """A page in the browser on which a scene can be explored, served by this process: a `View`.

    scene: a single `Scene`, or the path of a scene file, whose tables say what is looked at first, and whose [[view]]
    what was asked on a page before; changes: "key=value" each, as in `run`, of a file. port: None for the first free
    one of 8420 to 8439; address: of this machine's own. token: what the page's address must hold, None for a new one.
    The server ends with `View.stop`, or with the process; a page that is closed ends its own work.

    Raises SceneError and OSError as `load_scene` does, ArgumentError for a batch of scenes, for an address that is not
    loopback and a port that cannot be, OSError where no port is free.
    """
    if port is not None and check.whole_number("port", port, 0) > LAST_PORT:
        raise check.ArgumentError("port", f"must be at most {LAST_PORT}", port)
    if isinstance(scene, Scene):
        check.require_single(scene)
        file = SceneFile(scene=make_scene_table(scene)) if scene_toml_or_empty(scene) else None
        return View(Explorer(scene, file, address, port, token))
    file = scene_file.read(scene, changes)
    return View(Explorer(file.scene.make(), file, address, port, token))
