"""Candidate effects: where they can be, how large they are, how well each explains the residual."""
