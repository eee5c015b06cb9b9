"""The demo and the `via` command: what a user meets first."""
