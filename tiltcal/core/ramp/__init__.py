"""The drift of a sensor from a continuous record in one attitude, while its temperature goes up and down.

``record`` has the rows that count and the legs, ``means`` few means of them, the temperature of the element for any lag
and the noise; ``fit`` finds the polynomial and the thermal lag, and how uncertain both are.
"""
