"""Virtual sensors that answer the bytes of the real parts."""
