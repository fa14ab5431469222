"""Calibrations as other programs hold them: ``tiltcal export``."""
