"""The drift of a sensor from a continuous record in one attitude, while its temperature goes up and down.

``record`` keeps means of the rows, and ``temperature_jumps`` leaves out what a thermometer did not measure. ``means``
has what is fitted and ``element`` its temperature for any lag; ``fit`` finds the polynomial and the thermal lag.
``loops``, ``second_lag`` and ``noise`` compute how uncertain both are.
"""
