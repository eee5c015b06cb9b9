"""The report of a diagnosis, its figures and probabilities."""
