"""The operators of a session: a person, a program, or the virtual jig."""
