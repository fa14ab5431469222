"""Who carries out the positions: a person, a program, or the virtual jig."""
