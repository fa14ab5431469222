"""The calibration core: numpy in, numpy out; no files, no prompts, no clock."""
