"""Pairs of accelerometers on a rotary stage: their scale factors matched, their misalignment compensated."""
