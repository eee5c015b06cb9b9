"""A GapReport as text, page and charts; it computes no results."""
