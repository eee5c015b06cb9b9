"""Thin nodes: declare, convert, step, publish. No other module imports them."""
