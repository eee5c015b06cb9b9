"""Sealed benchmark: a second simulator (MuJoCo, no code shared with via_sim), sealed cases and their scores."""
