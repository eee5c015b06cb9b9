"""The demo: recordings of a real robot, a live simulated joint, a diagnosis, and controller scenes."""
