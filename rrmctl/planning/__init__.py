"""From a manifest to jobs: settings in layers, the grid, identities, and what it all will cost."""
