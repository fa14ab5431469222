"""The session at the bench: runner, operators, journal."""
