"""The sealed benchmark: a second simulator (MuJoCo) that shares no code with via_sim, sealed cases, their scores."""
