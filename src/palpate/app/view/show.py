"""The live page from Python: in a cell of a notebook, or in the browser."""

from __future__ import annotations

import atexit
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.app.view.server.address import DEFAULT_PORT, LOOPBACK, open_browser
from palpate.core.describe import Described, Fact
from palpate.core.extras import require
from palpate.core.faults import InputError, brief, integer_in_range
from palpate.scenes.scene import Scene
from palpate.surface.surface import Surface

if TYPE_CHECKING:  # they take a second to import
    from palpate.app.session.session import Session
    from palpate.app.view.server.host import Host
    from palpate.app.view.server.preparation import Preparation
    from palpate.dynamics.loads.foundation import Foundation
    from palpate.dynamics.run.model import Model

FRAME_HEIGHT = 560  # [px] of the page in a cell
CLOSE_SECONDS = 10.0  # in which a session may end
JOIN_INTERVAL = 0.5  # [s]


class LivePage(Described):
    """A live page of a body, made by `palpate.show`. As the last value of a cell it shows the page there.

    Parameters
    ----------
    host : Host
        The server of the page.
    title : str
    work : function
        Prepares the body, and steps it until the host stops.

    Attributes
    ----------
    address : str
        The address of the page on this machine, with its token.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000, poisson=0.45)
    >>> page = pt.show(pt.Solid(cloud, tissue, fixed="x-"), block=False)
    >>> page.address.startswith("http://127.0.0.1:")
    True
    >>> page.close()
    """

    def __init__(self, host: Host, title: str, work: Callable[[], object]) -> None:
        self._host, self._title_of_page, self._work = host, title, work
        self._error: BaseException | None = None
        self._closed = threading.Event()
        self._serving = host.serving()
        self._serving.__enter__()
        self._thread = threading.Thread(target=self._run, name="palpate page", daemon=True)
        self._thread.start()
        atexit.register(self.close)

    @property
    def address(self) -> str:
        """The address of the page on this machine, with its token."""
        return self._host.address

    def wait(self) -> None:
        """Wait until the page is closed, or until Ctrl-C, which closes it.

        Raises
        ------
        InputError
            The body could not be prepared.
        """
        try:
            while self._thread.is_alive():
                self._thread.join(JOIN_INTERVAL)  # a wait without a timeout cannot be interrupted everywhere
        except KeyboardInterrupt:
            pass
        self.close()
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Close the page, and stop the body; the end of the program does so, too."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._serving.__exit__(None, None, None)
        self._thread.join(CLOSE_SECONDS)
        atexit.unregister(self.close)

    def _run(self) -> None:
        """Prepare the body and step it; the page shows why a preparation has failed."""
        try:
            self._work()
        except BaseException as error:
            if not self._closed.is_set():
                self._error = error

    def _facts(self) -> list[Fact]:
        state = "closed" if self._closed.is_set() else "failed" if self._error is not None else "open"
        return [("body", self._title_of_page, ""), ("page", state, ""), ("address", self.address, "")]

    def _picture(self) -> str:
        if self._closed.is_set():
            return ""
        address = escape(self.address.replace(LOOPBACK, "localhost", 1))  # the same site as a notebook's
        style = f"flex:1 0 100%;width:100%;height:{FRAME_HEIGHT}px;border:0"
        return f'<iframe src="{address}" style="{style}" title="palpate" allow="fullscreen"></iframe>'


def show(
    what: Model | Scene | str | Path,
    *,
    port: int = DEFAULT_PORT,
    public_url: str | None = None,
    block: bool | None = None,
) -> LivePage:
    """Open the page on which a body is pressed and pulled, as `palpate view` does.

    In a notebook, the page is shown below the cell if this is its last value. Elsewhere a browser opens it. The page
    shows the progress while code is compiled and the body is prepared.

    Parameters
    ----------
    what : Solid, Membrane, ReducedModel, Scene, str or path
        A solid in the energy form, a membrane, a reduced model that takes a tool, or a scene, as of `open_scene`; a
        text or a path is that of a scene, a surface file or a reduced model. The body of a scene has the finest spacing
        that this machine steps in real time.
    port : int
        Port of the page; the next free one if it is taken.
    public_url : str, optional
        Address of a forwarded port or a proxy by which the browser reaches the page, as on a remote notebook server.
    block : bool, optional
        True waits until Ctrl-C. By default in a script, and not in a notebook or at a prompt.

    Returns
    -------
    LivePage

    Raises
    ------
    InputError
        No page shows such a body, or websockets is not installed.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000, poisson=0.45)
    >>> page = pt.show(pt.Solid(cloud, tissue, fixed="x-"), block=False)
    >>> "<iframe" in page._repr_html_()
    True
    >>> page.close()
    """
    port = integer_in_range("port", port, 1, 65535)
    require("websockets", "a live page")
    from palpate.app.view.server.host import Host

    title, preparation, run = _opened(what)
    host = Host(preparation, LOOPBACK, port, public_url, framed=True)
    page = LivePage(host, title, partial(run, host))
    in_notebook, interactive = _front_end()
    if not in_notebook and host.page.exists:
        threading.Thread(target=open_browser, args=(page.address,), name="palpate browser", daemon=True).start()
    if block if block is not None else not interactive:
        sys.stderr.write(f"open {page.address}  (stop with Ctrl-C)\n")
        page.wait()
    return page


def _opened(what: Any) -> tuple[str, Preparation, Callable[[Host], object]]:
    """Return the title of a page, what it shows at first, and the function that shows the body on its host."""
    from palpate.app.common.console import Console
    from palpate.app.models.input import Input, open_input
    from palpate.app.session.session import Session
    from palpate.app.view.command import Shown, damped, end_of, first_page, run_page
    from palpate.app.view.server.preparation import Preparation
    from palpate.dynamics.membrane.model import Membrane
    from palpate.dynamics.solid.model import EnergySolid
    from palpate.reduction.hyper.model import ReducedModel

    def make(body: Any, foundations: Sequence[Foundation] = (), end: str = "") -> Session:
        return Session(body, title, foundations=foundations, end=end)

    if isinstance(what, EnergySolid | Membrane | ReducedModel):
        cloud = what.cloud
        title = f"{what._title or type(what).__name__} of {len(cloud):,} nodes"
        surface = Surface(cloud.points, cloud.triangles) if cloud.points.shape[1] == 3 else None
        preparation = Preparation(title, title, surface)
        return title, preparation, partial(_show_model, preparation, partial(make, what))
    if not isinstance(what, Scene | str | Path):
        raise InputError(
            "what must be a Solid in the energy form, a Membrane, a ReducedModel, a Scene, or the name of a scene or a "
            f"file, got {brief(what)}; use plot for others"
        )
    opened = Input(what.name, what.title, what) if isinstance(what, Scene) else open_input(str(what))
    full, title = opened.scene is not None, opened.title
    if full:
        opened = damped(opened)
    preparation = first_page(opened, full, title)
    console = Console(preparation.begin, quiet=True)  # its lines are on the page
    shown = Shown(opened, full, partial(make, end=end_of(opened)))
    return title, preparation, partial(run_page, shown, preparation, console)


def _show_model(preparation: Preparation, make: Callable[[], Session], host: Host) -> None:
    """Step a model and show it on the page of a host until the host stops."""
    from palpate.app.view.command import preparing

    with preparing(host, preparation):
        preparation.begin("preparing the engine (the first time on a machine compiles it, for about a minute)")
        session = make()
        preparation.end()
    try:
        session.start()
        host.show(session)
        host.wait()
    finally:
        session.close()


def _front_end() -> tuple[bool, bool]:
    """Return whether the program runs in a notebook, and whether a person types at a prompt or in a notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    in_notebook = hasattr(shell, "kernel")
    return in_notebook, shell is not None or hasattr(sys, "ps1") or bool(sys.flags.interactive)
