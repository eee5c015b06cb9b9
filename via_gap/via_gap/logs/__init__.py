"""Logs of a joint: reading, cleaning, checks, and their replay on the nominal model."""
