"""Calibrate tilt sensors at the bench, and remove their errors from recorded logs."""

__version__ = "0.1.0"
