"""Which candidates the held-out data support."""
