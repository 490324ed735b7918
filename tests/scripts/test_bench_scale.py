"""The benchmark of the service on pretended workers, at its smallest."""

import pytest

from scripts.bench_scale import main

pytestmark = pytest.mark.slow


def test_the_light_mode_prints_the_cluster_and_each_look_at_the_store(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--workers", "2", "--seconds", "0.05", "--side", "2048", "--delay", "0.001"]) == 0
    shown = capsys.readouterr().out
    assert "| 2 | 64 |" in shown
    assert "| status of a running atlas, first and next |" in shown
    assert "| status of a finished atlas, first and next |" in shown
