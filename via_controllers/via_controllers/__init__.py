"""Controllers of joints and arms, one per file; their nodes are in via_controllers.nodes."""
