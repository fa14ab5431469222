"""johnny-five, in Node.js, reads our virtual parts: a judge in another language."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from subprocess import PIPE, Popen

import pytest

from .boards import Board

HERE = Path(__file__).parent
MODULES = HERE / "build" / "node" / "node_modules"

CASES = [
    # Model, its range, johnny-five's name of it, and the counts that it takes for 1 g.
    *(("adxl345", word, "ADXL345", 256.0) for word in (2, 4, 8, 16)),
    *(("lis3dh", word, "LIS3DH", counts / 16) for word, counts in ((2, 16380), (4, 8190), (8, 4096), (16, 1365))),
    ("mpu6050", 2, "MPU6050", 16384.0),
]


@pytest.mark.parametrize(("model", "word", "controller", "counts"), CASES)
def test_it_reads_the_truth(model: str, word: int, controller: str, counts: float) -> None:
    if not shutil.which("node") or not (MODULES / "johnny-five").exists():
        pytest.skip("johnny-five is not here: make test-judges installs it where npm can have it")
    board = Board(model, f"range={word}g")
    command = ["node", str(HERE / "johnny.js"), controller, str(word)]
    with Popen(command, stdin=PIPE, stdout=PIPE, text=True, env={**os.environ, "NODE_PATH": str(MODULES)}) as node:
        assert node.stdin is not None
        assert node.stdout is not None
        said = None
        for line in node.stdout:
            said = json.loads(line)
            if isinstance(said, dict):
                break
            out, count = said
            board.clock.sleep(0.001)
            print(json.dumps(list(board.part.exchange(bytes(out), count))), file=node.stdin, flush=True)
    assert isinstance(said, dict)
    # It prints three digits after the point.
    for axis, expected in zip("xyz", board.counts(), strict=True):
        assert said[axis] * counts == pytest.approx(expected, abs=0.51 + 0.0006 * counts)
    assert counts == pytest.approx(board.model.sensitivity, rel=0.03)
