"""Random damage to files, given to the public loaders."""
