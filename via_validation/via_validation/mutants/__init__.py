"""Mutations of the numerical heart, and whether the tests notice them: `via mutants`."""
