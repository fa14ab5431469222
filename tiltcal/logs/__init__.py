"""Recorded logs: read, compensated, averaged, cut into static intervals, and written."""
