"""The shipped procedures, as data."""
