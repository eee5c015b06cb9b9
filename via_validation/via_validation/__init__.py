"""Proof of the suite, which users do not need: second simulator, sealed benchmark, tables, comparison, benchmarks."""
