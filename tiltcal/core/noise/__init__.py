"""How noisy readings at rest are: averages, Allan deviation, the kinds of noise in it, and what averaging buys."""
