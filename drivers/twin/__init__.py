"""Virtual sensors that answer bytes as the parts would."""
