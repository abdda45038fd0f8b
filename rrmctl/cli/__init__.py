"""The commands of `rrmctl`; what they import at module level is light, so that help answers at once."""
