"""A running explorer: the public entry points, the cluster and the pages of a session, and how all of them end."""

import math
import os
import secrets
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

from atlas.errors import InputError
from atlas.explore.explorer import Explorer
from atlas.explore.server import HOST, PageServer, listening
from atlas.explore.subject import TOLERANCE, Subject, subject_of
from atlas.platform import processors
from atlas.query.open import handle_of
from atlas.query.window import Window, axis_names, axis_values
from atlas.service.clients import check_kind
from atlas.service.cluster import active_client, connect_to_scheduler, local_cluster
from atlas.service.options import RunOptions
from atlas.service.timing import TIMING, Timing
from atlas.store.store import AtlasStore

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client


HUB = "JUPYTERHUB_SERVICE_PREFIX"
"""Environment variable in which JupyterHub gives the path of this user's server."""


class ExplorerSession:
    """A running explorer and the server of its pages, until ``stop``.

    A notebook shows the first page as a cell's value.

    explorer   the explorer, which finds and solves cells
    folder     folder in which specs of new atlases are written
    port       port to listen at; 0 is any free port
    query      query of the address of new pages
    host       address to listen at
    """

    def __init__(self, explorer: Explorer, folder: Path, port: int = 0, query: str = "", host: str = HOST) -> None:
        from atlas.explore.connection import PageConnection, page_for
        from atlas.explore.picture_renderer import warm_up

        self.explorer = explorer
        self._proxy = os.environ.get(HUB, "").rstrip("/")
        self._pages: list[PageConnection] = []
        warm_up(explorer)
        token = secrets.token_urlsafe(16) if self._proxy else None

        def connect(send: Callable[[str | bytes], None], arguments: Mapping[str, list[bytes]]) -> PageConnection:
            page = PageConnection(explorer, folder, send, arguments)
            self._pages = [page, *(other for other in self._pages if not other.is_closed)]
            return page

        self._server = PageServer(partial(page_for, explorer), connect, port, host, token)
        self._query = "&".join(filter(None, [query, f"token={self._server.token}"]))

    @property
    def url(self) -> str:
        """The address of a new page, with the token that opens it."""
        return f"{self._server.url}?{self._query}"

    def stop(self) -> None:
        """End the server, which closes the pages, and stop the jobs on the cluster."""
        self._server.stop()
        self.explorer.stop()
        for page in self._pages:
            page.wait()

    @property
    def proxied_url(self) -> str:
        """The address of a new page from a notebook: through the proxy of JupyterHub if there is one, else ``url``."""
        if not self._proxy:
            return self.url
        return f"{self._proxy}/proxy/{self._server.port}/?{self._query}"

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.proxied_url}" width="100%" height="720" style="border: 0"></iframe>'


def explore(
    source: "str | AtlasStore | Subject",
    view: Mapping[str, float] | None = None,
    *,
    client: "Client | None" = None,
    scheduler: str | None = None,
    workers: int | None = None,
    tolerance: float = TOLERANCE,
    folder: Path | None = None,
    port: int = 0,
    host: str = HOST,
    window: Window | None = None,
    timing: Timing = TIMING,
    prepare: "Callable[[], None] | None" = None,
) -> ExplorerSession:
    """Start an explorer of a store or a spec, and return its session; its pages are at ``ExplorerSession.url``.

    source       store, spec by file or name, handle of a store, or subject
    view         value of the stack axis that selects a plane of a stack; by default the first plane
    client       Dask client to use; it is not closed
    scheduler    address of a Dask scheduler to connect to
    workers      number of local worker processes
    tolerance    least tolerance, the standard error of the largest exponent, of explored cells
    folder       folder in which specs of new atlases are written; by default the working directory
    port         port to listen at; 0 is any free port
    host         address to listen at; by default the loopback of this machine
    window       limits (low, high) of axes that are shown first, by name
    timing       time limits of the jobs on the cluster
    prepare      called once the input has been checked, before anything starts

    Without ``client``, ``scheduler`` and ``workers`` the active Dask client is used, or else one local worker process
    per processor. A page is sent only to addresses with the session's token. Raise InputError if the subject cannot be
    explored or an argument is invalid.
    """
    RunOptions(workers, scheduler)  # raises if they are invalid, or contradict each other
    if not 0 < tolerance < math.inf:
        raise InputError(f"tolerance: found {tolerance!r}, must be a number > 0")
    subject = source if isinstance(source, Subject) else subject_of(source, view, tolerance)
    for free in listening(port, host):  # before kernels are compiled, which takes long
        free.close()
    if prepare is not None:
        prepare()
    connect = _connection(client, scheduler, workers, timing)
    explorer = Explorer(subject, connect, timing)
    arguments = [(name, f"{low!r}:{high!r}") for name, (low, high) in (window or {}).items()]
    query = urlencode(arguments, safe=":")
    try:
        return ExplorerSession(explorer, folder or Path.cwd(), port, query, host)
    except BaseException:
        explorer.stop()
        raise


def explore_dataset(ds: "xr.Dataset", tolerance: float = TOLERANCE, **options: Any) -> ExplorerSession:
    """Start an explorer of the store from which a dataset was opened, at the dataset's plane and window.

    Return the session. Further options are those of ``explore``. Raise InputError unless the dataset is as
    ``atlas.open`` returned it, or one plane of a stack or a part of a plane of such a dataset.
    """
    ends = {name: axis_values(ds, name) for name in axis_names(ds)[:2]}
    window = {name: (float(values.min()), float(values.max())) for name, values in ends.items() if values.size > 1}
    return explore(*_place(ds), window=window, tolerance=tolerance, **options)


def _place(ds: "xr.Dataset") -> tuple[AtlasStore, dict[str, float]]:
    """Return the handle of a dataset's store, and the value of the stack axis at the dataset's plane, by name."""
    handle = handle_of(ds)
    axes = handle.spec.axes[2:]
    return handle, {axis.name: float(ds[axis.name]) for axis in axes if ds[axis.name].ndim == 0}


def _connection(
    client: "Client | None", scheduler: str | None, workers: int | None, timing: Timing
) -> "Callable[[], AbstractContextManager[Client]]":
    if client is not None:
        check_kind(client)
        dask_client = client
        return lambda: nullcontext(dask_client)
    if scheduler is not None:
        return partial(connect_to_scheduler, scheduler, timing=timing)
    active = active_client() if workers is None else None
    if active is not None:
        return lambda: nullcontext(active)
    return partial(local_cluster, workers or processors())
