"""File formats: declared, read, checked and written."""
