"""Connections: encrypted ones, and what is open to other machines."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import dask
import psutil
import pytest
from click.testing import CliRunner
from distributed import Client, LocalCluster, Security

import atlas
from atlas.cli.main import main
from atlas.errors import InputError
from atlas.service.cluster import Tls, local_cluster
from atlas.service.dispatch import MAX_IN_FLIGHT
from atlas.service.options import RunOptions
from atlas.service.timing import Timing
from tests.planes import plane_of


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """A certificate that is its own authority, and its key."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("needs openssl to make a certificate")
    folder = tmp_path_factory.mktemp("tls")
    cert, key = str(folder / "cert.pem"), str(folder / "key.pem")
    options = ["-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    subprocess.run([openssl, "req", "-x509", *options, "-keyout", key, "-out", cert], check=True, capture_output=True)
    return cert, key


@pytest.fixture(scope="module")
def encrypted(certificate: tuple[str, str]) -> Iterator[str]:
    """The address of a cluster that takes encrypted connections only."""
    cert, key = certificate
    roles = ("scheduler", "worker", "client")
    pairs = {f"tls_{role}_{what}": file for role in roles for what, file in (("cert", cert), ("key", key))}
    security = Security(tls_ca_file=cert, require_encryption=True, **pairs)
    with LocalCluster(
        processes=False,
        n_workers=1,
        threads_per_worker=2,
        host="127.0.0.1",
        protocol="tls://",
        dashboard_address="127.0.0.1:0",
        security=security,
    ) as cluster:
        yield cluster.scheduler_address


def test_a_run_reaches_an_encrypted_scheduler_by_the_files_given(
    tmp_path: Path, encrypted: str, certificate: tuple[str, str]
) -> None:
    assert encrypted.startswith("tls://")
    cert, key = certificate
    summary = atlas.run(
        plane_of(), tmp_path / "out.zarr", options=RunOptions(scheduler=encrypted, tls=Tls(cert, cert, key))
    )
    assert summary.tiles_done == 9


def test_a_run_reaches_an_encrypted_scheduler_by_dasks_configuration(
    tmp_path: Path, encrypted: str, certificate: tuple[str, str]
) -> None:
    cert, key = certificate
    tls = "distributed.comm.tls"
    given = {f"{tls}.ca-file": cert, f"{tls}.client.cert": cert, f"{tls}.client.key": key}
    with dask.config.set(given):
        summary = atlas.run(plane_of(), tmp_path / "out.zarr", options=RunOptions(scheduler=encrypted))
    assert summary.tiles_done == 9


def test_a_run_without_certificates_is_refused_in_one_line(tmp_path: Path, encrypted: str) -> None:
    shown = CliRunner().invoke(main, ["run", "tiny", "-o", str(tmp_path / "out.zarr"), "--scheduler", encrypted])
    assert (shown.exit_code, len(shown.stderr.splitlines())) == (2, 1)
    assert f"{encrypted}: no scheduler answers" in shown.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_certificate_that_is_not_there_is_named() -> None:
    with pytest.raises(InputError, match=r"TLS certificate /nowhere/cert.pem: no such file"):
        Tls(cert="/nowhere/cert.pem")


def listening() -> set[tuple[str, int]]:
    """Addresses at which this process and its children take connections."""
    us = psutil.Process()
    found = [c for process in (us, *us.children(recursive=True)) for c in process.net_connections("inet")]
    return {(c.laddr.ip, c.laddr.port) for c in found if c.status == psutil.CONN_LISTEN}


def test_the_local_cluster_is_open_to_this_machine_only() -> None:
    before = listening()
    with local_cluster(1):
        opened = listening() - before
    assert len(opened) >= 3  # scheduler, nanny and worker
    assert {host for host, _ in opened} == {"127.0.0.1"}


INTRUDER = """
import os, sys
from distributed import Client
address = sys.argv[1]
if os.geteuid() == 0:
    os.setgid(65534)
    os.setuid(65534)  # as another user of this machine, where that can be tried
try:
    with Client(address, timeout=3, set_as_default=False) as client:
        print("as user", client.run_on_scheduler(os.geteuid))
except Exception:
    print("refused")
"""


def test_no_other_user_of_this_machine_can_run_code_on_the_local_cluster() -> None:
    """Truth: a scheduler runs what it is sent; without certificates another user's function ran as the owner."""

    def tried(*addresses: str) -> list[str]:
        begun = [
            subprocess.Popen([sys.executable, "-c", INTRUDER, address], stdout=subprocess.PIPE, encoding="utf-8")
            for address in addresses
        ]
        return [process.communicate(timeout=60)[0].strip() for process in begun]

    with LocalCluster(n_workers=0, host="127.0.0.1", protocol="tcp", dashboard_address="127.0.0.1:0") as unsafe:
        assert tried(unsafe.scheduler_address) == [f"as user {os.geteuid()}"]
    with local_cluster(1) as client:
        address = str(client.scheduler.address)
        assert tried(address, address.replace("tls", "tcp")) == ["refused", "refused"]
        assert client.submit(sum, [1, 2]).result() == 3


@pytest.mark.slow
def test_no_more_tiles_are_at_the_scheduler_than_the_window_holds(tmp_path: Path, client: Client) -> None:
    held: list[int] = []
    options = RunOptions(
        on_progress=lambda _: held.append(client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))),
        timing=Timing(tick=0.0),
    )
    atlas.run(plane_of((1, 1)), tmp_path / "out.zarr", client, options)
    assert len(held) > 35
    assert max(held) <= MAX_IN_FLIGHT * 2


def test_workers_of_the_local_cluster_do_not_sample_their_threads() -> None:
    sampled = "distributed.worker.profile.enabled"
    with dask.config.set({sampled: True}), local_cluster(1) as client:
        found = client.run(lambda: dask.config.get(sampled))
    assert list(found.values()) == [False]
