"""Noise of readings at rest: averages, Allan deviation, its kinds, and the gain of averaging."""
