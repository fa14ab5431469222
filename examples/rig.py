"""A rig of one's own leads the session: tiltcal asks for a position, the rig moves there and says where it stands."""

import tiltcal


class TiltTable:
    """Your two motors with their encoders, in degrees; here they stop up to 0.01° beside what was asked for."""

    def move(self, axis: str, degrees: float) -> float:
        print(f"  {axis} to {degrees:g}°")
        return round(degrees, 1) + (0.01 if axis == "x" else -0.01)


class Operator:
    """What tiltcal calls: only ``position`` is needed."""

    def __init__(self, table: TiltTable) -> None:
        self.table = table

    def position(self, ask: dict) -> dict:
        print(ask["prompt"])
        reached = {axis: self.table.move(axis, degrees) for axis, degrees in ask["tilt"].items()}
        return {"answer": "ready", "tilt": reached}

    def accepted(self, event: dict) -> None:
        print(f"  {event['n']} samples, mean {event['mean']}")

    def refused(self, event: dict) -> None:
        print(f"  refused: {event['why']}")


sensor = {"sensor": "sca100t-d02", "address": "sim:seed=7", "serial": "S-0042"}  # a real one: spi:///dev/spidev0.0
cal = tiltcal.measure("plane", **sensor, jig=0.01, operator=Operator(TiltTable()), output="S-0042.yaml")
print(cal)
