"""The benchmark of the service on pretended workers, at its smallest."""

import pytest

from scripts.bench_scale import main

pytestmark = pytest.mark.slow


def test_the_light_mode_prints_the_cluster_and_each_look_at_the_store(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--workers", "2", "--seconds", "0.05", "--side", "2048", "--delay", "0.001"]) == 0
    shown = capsys.readouterr().out
    table = [line.split() for line in shown.splitlines()]
    assert ["2", "64"] in [words[:2] for words in table]
    assert "status of the running atlas" in shown
    assert "status of the finished atlas" in shown
    assert shown.count("; 16 tiles") == 2
    assert shown.count("; 8 tiles") == 2
