"""The drift of a sensor from a continuous record in one attitude, while its temperature goes up and down.

``record`` has the means of the rows and the legs; ``fit`` finds the polynomial and the thermal lag, and how uncertain
both are.
"""
