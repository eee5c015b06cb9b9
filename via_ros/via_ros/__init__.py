"""The only shared ROS code: conversions, parameters, quality of service, spin."""
