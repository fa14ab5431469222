"""Match the accelerometers of a rotary stage at the bench, then apply the pairs to what the stage recorded."""

import numpy as np

import tiltcal

pairs = tiltcal.measure(
    "rotation",
    sensor="gradiometer",
    address="sim:?seed=3",  # a real one: serial:///dev/ttyUSB0?columns=time,theta,a1,a2,a3,a4
    serial="G-1",
    operator="sim",
    turns=5,
    output="G-1.yaml",
)
for matching in pairs.matchings:
    print(f"p = {matching.p:.6f} ± {matching.u_p:.6f}, q = {matching.q:.6f} ± {matching.u_q:.6f}")

with tiltcal.open_sensor("gradiometer", "sim:?seed=3") as stage:
    readings = np.array([stage.read().values for _ in range(2000)])
matched = pairs.apply(dict(zip(("theta", "a1", "a2", "a3", "a4"), readings.T, strict=True)))
before = np.std(np.sum([matched["a1"], matched["a2"]], axis=0))
print(f"a1 + a2: standard deviation {before:.2g} before, {np.std(matched['matched_a1_a2']):.2g} after")
