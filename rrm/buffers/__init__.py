"""What a run remembers: its experience, and the preferences over parts of it."""
