"""Nodes of this package; no other package imports them."""
