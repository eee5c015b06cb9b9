"""Thin nodes: declare, convert, step, publish. Nobody imports them."""
