"""The journal of a session: its header, its lines, and what they give."""
