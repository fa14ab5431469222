"""Our virtual parts answer public programs that nobody packages: their frames and arithmetic give the truth."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from support.virtual_device import VirtualDevice

from tiltcal.drivers import find_model

SKETCHES = yaml.load(Path(__file__).with_name("sketches.yaml").read_text(encoding="utf-8"), yaml.CBaseLoader)
TILTED = (0.2, -0.15, 0.9375**0.5)
"""Within ±15°, the narrowest range."""


def word(device: VirtualDevice, frame: str, bits: int) -> int:
    """The first 11 of the bits that come behind the command."""
    device.clock.sleep(200e-6)
    answer = device.line.exchange(bytes.fromhex(frame))
    taken = (int.from_bytes(answer, "big") >> 16 - bits) & ((1 << bits) - 1)
    return taken >> bits - 11


@pytest.mark.parametrize(("sketch", "model"), [(sketch, model) for sketch in SKETCHES for model in sketch["models"]])
def test_its_arithmetic_gives_the_truth(sketch: dict[str, Any], model: str) -> None:
    device = VirtualDevice(find_model(model), noise={})
    device.fixture.move(TILTED)
    assert device.model.spi is not None
    assert int(sketch.get("mode", 0)) in device.model.spi.modes
    assert int(sketch.get("clock", 0)) <= (device.model.spi.fastest or 0)
    for frame in sketch.get("before", ()):
        device.line.exchange(bytes.fromhex(frame))
    counts_per_g, zero = float(sketch["models"][model]), float(sketch["zero"])
    for channel, frames in sketch["frames"].items():
        words = [word(device, frame, int(sketch.get("bits", 16))) for frame in frames]
        g = (words[0] - sum(words[1:]) - zero) / counts_per_g
        expected = (device.expected(channel) - device.model.offset) / device.model.sensitivity
        assert g == pytest.approx(expected, abs=0.51 * len(frames) / counts_per_g)
    if "temperature" in sketch:
        frame, zero, slope = sketch["temperature"]
        celsius = (device.line.exchange(bytes.fromhex(frame))[1] - float(zero)) / float(slope)
        assert celsius == pytest.approx(24.0 + device.truth.thermometer_error, abs=0.5 / 1.083)


def test_each_kind_of_part_is_there_by_at_least_three_authors_in_all() -> None:
    assert len({sketch["source"].partition(",")[0] for sketch in SKETCHES}) >= 3
    kinds = {model.partition("t")[0] for sketch in SKETCHES for model in sketch["models"]}
    assert kinds == {"sca100", "sca103", "sca61"}
