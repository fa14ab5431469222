"""The drift of a sensor from a continuous record in one attitude, while its temperature goes up and down.

``record`` has the rows that count and the legs, ``means`` the temperature of the element in few means of them for any
lag; ``fit`` finds the polynomial and the thermal lag, and how uncertain both are.
"""
