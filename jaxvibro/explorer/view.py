"""Serve the page of a scene while the program or notebook continues."""

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
from .server import ExplorerServer

HEIGHT = 900  # pixels, height of the page in a notebook
LAST_PORT = 65535


class View:
    """Running server of a page.

    A notebook displays the page in place of this object.

    Attributes
    ----------
    url : str
        Address of the page with its token. Only this machine can open it.
    """

    def __init__(self, explorer: ExplorerServer) -> None:
        self.url = explorer.url
        self._explorer = explorer
        self._thread = threading.Thread(target=lambda: asyncio.run(explorer.serve()), daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Wait until the server ends."""
        while self._thread.is_alive():
            self._thread.join(0.2)

    def stop(self) -> None:
        """Stop the server and the tasks of its pages."""
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
    """Serve a browser page on which a scene can be explored.

    This process serves the page. The server runs until `View.stop` is called or the process ends. Closing a page stops
    the tasks of that page.

    Parameters
    ----------
    scene : Scene or str or path-like
        Single scene, or path of a scene file. The tables of a file select the first results, and its ``[[view]]``
        tables restore the calls of an earlier page.
    port : int, optional
        Port. None selects the first free port from 8420 to 8439, and 0 selects any free port.
    address : str, optional
        Loopback address of this machine.
    changes : sequence of str, optional
        Changes to the scene file, each ``"key=value"``, as in `jaxvibro.run`.
    token : str, optional
        Secret in the address of the page. None makes a new one.

    Returns
    -------
    View
        Running server, with the address of the page as `url`.

    Raises
    ------
    SceneError
        If the scene file or one of the `changes` breaks a rule.
    OSError
        If the scene file cannot be read, or no port is free.
    ArgumentError
        If `scene` is a batch of scenes, `address` is not a loopback address, or `port` is not a valid port.

    See Also
    --------
    jaxvibro.run : Run the analyses in a scene file.

    Examples
    --------
    >>> page = jv.view(scene)
    >>> page.url.partition("/?")[0][:17]
    'http://127.0.0.1:'
    >>> page.stop()
    """
    if port is not None:
        check.check_whole_number("port", port, 0, LAST_PORT)
    if isinstance(scene, Scene):
        check.require_single_scene(scene)
        file_tables = SceneFile(scene=make_scene_table(scene)) if scene_toml_or_empty(scene) else None
        return View(ExplorerServer(scene, file_tables, address, port, token))
    file_tables = scene_file.read_scene_file(scene, changes)
    return View(ExplorerServer(file_tables.scene.make(), file_tables, address, port, token))
