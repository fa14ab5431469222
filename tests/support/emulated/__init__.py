"""Real bus libraries against emulated device nodes, with parts written independently of the drivers' twins."""
