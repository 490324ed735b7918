"""The set-up shared by all functions that compute into a store: options, backend and lease of the store, and Dask
client.
"""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from atlas.argument_checks import validate_type
from atlas.service.clients import check_client, connect_client, worker_count
from atlas.service.cluster import leave_if_bootstrapping
from atlas.service.lease import Lease, hold_lease
from atlas.service.notebook import progress_reporter
from atlas.service.options import RunOptions
from atlas.service.progress import Progress
from atlas.store.create import remove_half_made
from atlas.store.object_backend import Given, StoreBackend, open_backend, with_patience
from atlas.store.sidecar import sidecar_of
from atlas.store.store import AtlasStore, open_store

if TYPE_CHECKING:
    from distributed import Client


@dataclass
class StoreCall:
    """A call of a function that computes into a store, with the resources that it holds until ``stack`` is closed.

    backend   backend of the store; once the store is leased, each write that finishes a tile or a
              table confirms the lease
    options   options of the call, with a reporter of its progress
    client    client of the workers; None if a local cluster is to be started
    stack     resources that are released at the end of the call
    threads   number of worker threads, once connected
    lease     lease of the store, once acquired
    """

    backend: StoreBackend
    options: RunOptions
    client: "Client | None"
    stack: ExitStack
    threads: int = 0
    lease: Lease = field(init=False)

    def open(self) -> AtlasStore:
        """Open the store and return its handle, waiting up to ``options.patience`` seconds for a server that does not
        respond.

        Raise InputError if there is no atlas.
        """
        return open_store(with_patience(self.backend, self.options.patience))

    def connect(self) -> None:
        """Find the workers: those of the given client, of the options' scheduler, of an active client, or processes of
        this host.
        """
        self.client = connect_client(self.client, self.options, self.stack)
        self.threads = worker_count(self.client, self.options)

    def acquire_lease(self) -> None:
        """Lease the store until the call ends, and remove what killed runs have left of a store in its place.

        A single heartbeat, a renewal of the lease, waits only as long as the backend does. The run as a whole waits
        ``options.patience`` seconds for the store; meanwhile every write that finishes a tile still confirms the lease.
        Raise InputError if another run holds the lease.
        """
        backend, options = self.backend, self.options

        def say(text: str) -> None:
            options.report(Progress(text))

        patience = options.patience if backend.local is None else 0.0
        holding = hold_lease(sidecar_of(backend), str(backend), say, options.timing, patience)
        self.lease = self.stack.enter_context(holding)
        if backend.local is not None:
            remove_half_made(backend.local)
        self.backend = self.lease.bind(with_patience(backend, options.patience))


@contextmanager
def store_call(
    store: Given, client: "Client | None", options: RunOptions, fields: Mapping[str, Any]
) -> Iterator[StoreCall]:
    """Begin a call that computes into a store, and end it with the block.

    store    path, URL or backend of the store
    client   Dask client to compute on, or None
    options  options of the call
    fields   fields of RunOptions that replace those of ``options``

    Raise InputError if the client contradicts the options, and TypeError for a field that is no option.
    """
    leave_if_bootstrapping()
    options = replace(validate_type("options", options, RunOptions, "an atlas.RunOptions"), **fields)
    check_client(client, options)
    with progress_reporter(options.on_progress) as report, ExitStack() as stack:
        backend = open_backend(store, storage_options=options.storage_options)
        yield StoreCall(backend, replace(options, on_progress=report), client, stack)
