"""Diagnoses as tasks: of fleets, in a worker process, of arms, on live data."""
