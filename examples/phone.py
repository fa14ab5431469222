"""From a phone's log to a figure: calibrate from attitudes that nobody set, and plot the inclination."""

import sys

import matplotlib.pyplot as plt
import numpy as np
import polars

import tiltcal


def record(path: str) -> None:
    """Write what an app would of fourteen attitudes: a phone with an offset of 0.3 m/s² along z."""
    random = np.random.default_rng(3)
    attitudes = np.vstack([np.eye(3), -np.eye(3), random.normal(size=(8, 3))])
    up = np.repeat(attitudes / np.linalg.norm(attitudes, axis=1, keepdims=True), 200, axis=0)
    still = np.tile(np.arange(200) < 150, len(attitudes))
    readings = 9.81 * up + (0.1, -0.2, 0.3) + random.normal(0.0, 1.0, up.shape) * np.where(still, 0.02, 3.0)[:, None]
    names = ("Time (s)", *(f"Acceleration {axis} (m/s^2)" for axis in "xyz"))
    polars.DataFrame(np.column_stack([np.arange(len(up)) / 50, readings]), schema=names).write_csv(path)


log = sys.argv[1] if len(sys.argv) > 1 else "acceleration.csv"
if log == "acceleration.csv":
    record(log)
cal = tiltcal.fit("free", log, serial="PHONE")
print(cal)
cal.save("phone.yaml")

tilted = cal.apply(polars.read_csv(log))
figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
axes.plot(tilted[tilted.columns[0]], tilted["inclination"], lw=0.8)
axes.set(xlabel="time [s]", ylabel="inclination [°]", ylim=(0, 180))
figure.savefig("inclination.svg")
