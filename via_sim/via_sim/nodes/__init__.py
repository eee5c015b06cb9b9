"""Simulator nodes: they declare parameters, convert messages, step and publish. Other packages do not import them."""
