"""Estimators: one algorithm per file; the nodes live in via_estimators.nodes."""
