"""What the model leaves unexplained: segments of a log, their rollouts, the equations, and device numbers."""
