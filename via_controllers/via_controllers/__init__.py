"""Controllers and excitations: one law per file; the nodes live in via_controllers.nodes."""
