"""Pages and figures of a calibration."""
