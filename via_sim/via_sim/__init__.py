"""Simulation: plants, effects, integrators and sensors; the nodes live in via_sim.nodes."""
