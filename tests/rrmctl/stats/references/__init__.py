"""Values that other programs compute, each beside the script that makes it."""
