"""The child process of commands whose library may crash."""

import os
import time
from pathlib import Path

import pytest

from tiltcal.cli import child_process

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")


def test_the_end_of_the_child_ends_the_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "log.parquet"
    log.touch()
    monkeypatch.setattr(child_process, "_LOOK", 60.0)
    begun = time.monotonic()
    assert child_process.run_guarded(lambda: 7, [str(log)]) == 7
    assert time.monotonic() - begun < 30.0
