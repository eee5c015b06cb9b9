"""Sensor and clock errors that the measurements show by themselves."""
