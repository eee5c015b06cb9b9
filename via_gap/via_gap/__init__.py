"""The gap between a simulated and a real joint."""
