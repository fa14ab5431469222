"""The drift of a sensor from a continuous record in one attitude, while its temperature goes up and down.

``record`` keeps means of the rows, ``temperature_jumps`` leaves out what a thermometer did not measure, ``means`` holds
what is fitted, and ``fit`` finds the polynomial and the thermal lag. ``loops``, ``second_lag`` and ``noise`` say how
uncertain both are.
"""
