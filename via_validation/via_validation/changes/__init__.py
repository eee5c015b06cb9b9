"""Joints whose springs or dampers change while they move, and how the estimators follow: `via changes`."""
