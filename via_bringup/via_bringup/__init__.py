"""The `via` command, the demo, and shared parts of the launch files."""
