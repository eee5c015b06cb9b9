"""Faults injected into the live graph: what each node must do, and what it did."""
