"""The core of VIA: signals, spring laws, devices, weak-form kernels, metrics and bags. Independent of ROS."""
