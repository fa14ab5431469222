"""What `import tiltcal` gives: calibrations as a program holds them, and the functions that make or take them."""
