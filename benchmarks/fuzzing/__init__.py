"""Damaged input for every reader, driver and command."""
