"""Doors for recorded logs."""
