"""The formats: what is read, checked and written."""
