"""From measured positions to a calibration, and what may be expected of one before it is measured."""
