"""The experiments of Section 6 in simulation, without ROS: one file per experiment, each returns its figures."""
