"""The blind check: a second simulator (MuJoCo) that shares no code with via_sim, sealed cases, and their scoring."""
