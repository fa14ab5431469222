"""A night in a chamber: sensors of a bench file, and a chamber that is an object of one's own."""

from pathlib import Path

import tiltcal

BENCH = """\
tiltcal: 1
kind: bench
operator: R. Hooke
jig: 0.05
sensors:
  - {serial: A-1, model: sca100t-d02, address: "sim:seed=1"}
"""


class Chamber:
    """Your chamber: what is set, and what it reads back."""

    temperature = 23.0

    def position(self, ask: dict) -> dict:
        if ask["temperature"] not in (None, self.temperature):
            self.temperature = ask["temperature"]
            print(f"the chamber goes to {self.temperature:g} °C")
        return {"answer": "ready"}


Path("bench.yaml").write_text(BENCH, encoding="utf-8")
# Of several sensors a list comes back.
cal = tiltcal.measure("mavs", bench="bench.yaml", operator=Chamber(), samples=20, output=".")
drift = cal.coefficients.thermal.drift[:, 0]
for channel, coefficient in zip(cal.sensor.channels, drift, strict=True):
    u = cal.uncertainty[f"temperature.offset.{channel}.1"]
    print(f"{cal.sensor.serial} {channel}: {coefficient:.3f} ± {u:.3f} count/°C")
