"""Shared ROS code: conversions, parameters, QoS profiles, executors, recorder and player."""
