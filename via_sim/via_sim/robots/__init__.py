"""Robots of several flexible joints: arms with walls and hands at their tip, and the hopper."""
