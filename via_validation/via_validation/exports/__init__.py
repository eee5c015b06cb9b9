"""Repairs of reports exported to other simulators: their gap in MuJoCo, and readers of their files."""
