"""Off-policy agents."""
