"""The laws of Sections 6 and 7 in closed loop with simulated robots: what tables, scenes and tests share."""
