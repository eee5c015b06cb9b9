"""Bags: MCAP recordings in the format of rosbag2, written message by message and read as columns."""
