"""A GapReport for people: words, a page, pictures. Numbers are made elsewhere."""
