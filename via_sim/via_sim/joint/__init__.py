"""Physics of one joint, compiled: parameter row, torques, drives, encoders, integrator, measurements."""
