"""Controllers of arms, and what they are made of."""
